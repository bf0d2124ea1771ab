"""The command `convert`: makes a glTF file of a scene that Blender reads, in a process of Blender's."""

import json
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from scene_attack.cli.commands.options import JsonOption
from scene_attack.cli.console import err, print_json, remark
from scene_attack.scenes.bundle import CONVERTED_KINDS

SUFFIXES = tuple(f".{kind}" for kind in CONVERTED_KINDS)
UNRESOLVED = re.compile(r"Could not (?:open asset|load sublayer) @([^@\n]*)@")
"""What USD prints of a layer that another one refers to."""


def convert(
    file: Annotated[Path, typer.Argument(help=f"A scene: a file that ends in {', '.join(SUFFIXES)}.")],
    out: Annotated[Path, typer.Argument(help="The file to write; it ends in .glb.")],
    as_json: JsonOption = False,
) -> None:
    """Make a glTF file, which `scene show` and requests read, of a scene of Blender or USD.

    Blender does it, so that what needs Blender's package is this command alone. Scripts of the file are not run, and
    files outside its folder are not read. What the file has and the glTF file has not is said.
    """
    from scene_attack.disk import write
    from scene_attack.errors import InvalidRequest
    from scene_attack.process import program
    from scene_attack.scenes.reading.isolated import listed
    from scene_attack_blender.conversion import NOTES, SCENE
    from scene_attack_blender.plugin import check_installed
    from scene_attack_blender.process import ended, environment

    if file.suffix.lower() not in SUFFIXES:
        raise InvalidRequest("FILE", f"{file.name} ends in none of {', '.join(SUFFIXES)}")
    if not file.is_file():
        raise InvalidRequest("FILE", f"there is no file {file}")
    if out.suffix.lower() != ".glb":
        raise InvalidRequest("OUT", f"{out.name} does not end in .glb, and a GLB file is what is written")
    if out.is_dir():
        raise InvalidRequest("OUT", f"{out} is a folder")
    if not out.parent.is_dir():
        raise InvalidRequest("OUT", f"there is no folder {out.parent}; make it first")
    check_installed("FILE", "the conversion")
    with tempfile.TemporaryDirectory() as folder, err().status("Blender converts the file"):
        run = subprocess.run(
            program("scene_attack_blender.conversion", str(file.resolve()), folder),
            env=environment(folder),
            cwd="/",
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            check=False,
        )
        if run.returncode != 0:
            failure = ended(run.returncode, run.stderr)
            if failure.kind != "internal":
                raise failure
            raise InvalidRequest("FILE", f"{failure.detail}, while it read {file.name}")
        notes = json.loads(Path(folder, NOTES).read_bytes())
        if notes["unconfined"] is not None:
            remark(f"nothing kept Blender from files outside the folder of {file.name}: {notes['unconfined']}")
        if notes["error"] is not None:
            raise InvalidRequest("FILE", f"Blender cannot read {file.name}: {notes['error']}")
        write(out, Path(folder, SCENE).read_bytes())
    layers = dict.fromkeys(UNRESOLVED.findall(run.stderr))
    unresolved = [f"the layer {layer}: it is not there, or outside the folder of the file" for layer in layers]
    missing = listed((*unresolved, *notes["missing"]))
    if as_json:
        print_json({"file": str(out), "missing": missing})
        return
    remark(*(f"not converted: {phrase}" for phrase in missing))
    remark(f"Scene in {out}; scene-attack scene show {out} prints what is in it")


def add(root: typer.Typer) -> None:
    """Adds the command to those of `scene-attack`."""
    root.command(
        epilog="Examples: [bold]scene-attack convert room.blend room.glb[/bold]\n\n"
        "[bold]scene-attack convert kitchen.usdz kitchen.glb[/bold]"
    )(convert)
