"""The command `scene show`: what a file of a whole scene holds, and its picture."""

from collections.abc import Iterator
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scene_attack.cli.commands.options import JsonOption
from scene_attack.cli.console import FittedTable, err, print_json, remark, say

if TYPE_CHECKING:
    from scene_attack.scenes.library import Library
    from scene_attack.scenes.scene_file import SceneFile

app = typer.Typer(help="Files that hold a whole scene.", no_args_is_help=True)
SHOWN = {"nodes", "cameras", "lights"}
"""The parts of a scene that --json prints."""
UNITS = {"point": "cd", "spot": "cd", "directional": "lx"}


@app.callback()
def _group() -> None:
    """Keeps `show` a command of its own, though it is the only one."""


@app.command(
    epilog="Examples: [bold]scene-attack scene show room.glb[/bold]\n\n"
    "[bold]scene-attack scene show room.glb --out scene.png[/bold], which also draws it"
)
def show(
    file: Annotated[Path, typer.Argument(help="A scene: a .glb file, a .gltf file, or a zip file of one.")],
    out: Annotated[Path | None, typer.Option(help="Write a picture of the whole scene to this PNG file.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the nodes of a scene's file with their sizes in metres, its cameras and lights, and what is not shown.

    `scene.source.change` of a request names the nodes that an attack may change, by their names or numbers. The file is
    added to this machine's uploads, as `run` does. The picture has the file's first camera, and the pyrender renderer.
    """
    from scene_attack.cli.specs import local_library
    from scene_attack.client.meshes import bundle_at
    from scene_attack.errors import InvalidRequest
    from scene_attack.runs.environment import options_to_run, read_options
    from scene_attack.scenes.file_source import whole_scene

    if out is not None and not out.parent.is_dir():
        raise InvalidRequest("--out", f"there is no folder {out.parent}; make it first")
    options = read_options() if out is None else options_to_run()
    library = local_library(options)
    name = library.add(bundle_at(file, options), options).name
    scene = library.scene(name)
    whole = whole_scene(scene, name)
    if out is not None:
        with err().status("rendering"):
            _draw(whole.fields, library, out)
    if as_json:
        print_json({"name": name, **scene.model_dump(mode="json", include=SHOWN), "missing": whole.missing})
        return
    say(FittedTable(("#>", "node", "what it is", "size in metres>", "triangles>"), _rows(scene), spare=("triangles",)))
    remark(*(f"not shown: {phrase}" for phrase in whole.missing), *([] if out is None else [f"Picture in {out}"]))


def _rows(scene: "SceneFile") -> Iterator[list[str]]:
    kinds: dict[int, list[str]] = {}
    for camera in scene.cameras:
        kinds.setdefault(camera.node, []).append(f"camera, {degrees(camera.field_of_view):.3g}° high")
    for light in scene.lights:
        kinds.setdefault(light.node, []).append(f"{light.kind} light, {light.intensity:.3g} {UNITS[light.kind]}")
    depths: list[int] = []
    for number, node in enumerate(scene.nodes):
        depths.append(0 if node.parent is None else depths[node.parent] + 1)
        kind = (["mesh"] if node.triangles else []) + kinds.get(number, [])
        size = "" if node.extent is None else " × ".join(f"{side:.3g}" for side in node.extent.size)
        triangles = f"{node.triangles:,}" if node.triangles else ""
        yield [str(number), "  " * depths[number] + node.name, "; ".join(kind), size, triangles]


def _draw(fields: dict[str, Any], library: "Library", out: Path) -> None:
    from scene_attack.analysis.images import save_png
    from scene_attack.rendering.color import to_bytes
    from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
    from scene_attack.scenes.description import Scene
    from scene_attack.scenes.resolve import resolve

    whole = resolve(Scene.model_validate(fields), library)
    save_png(to_bytes(PyrenderRenderer(whole, tolerance="exact").render({}))[0], out)
