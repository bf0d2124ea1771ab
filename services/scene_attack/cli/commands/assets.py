"""The commands `assets`: the meshes and environment maps that a request can name."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from scene_attack.cli.commands.options import JsonOption, UrlOption
from scene_attack.cli.console import FittedTable, err, print_found, print_json, remark, say
from scene_attack.client import DEFAULT_URL

app = typer.Typer(help="The meshes and environment maps that scenes are made of.", no_args_is_help=True)


@app.command(
    "list",
    epilog="Examples: [bold]scene-attack assets list --search piano[/bold]\n\n"
    "[bold]scene-attack assets list --category Bathroom --licence CC0[/bold]",
)
def list_assets(
    category: Annotated[str | None, typer.Option(help="Only this category.")] = None,
    creator: Annotated[str | None, typer.Option(help="Only this creator.")] = None,
    licence: Annotated[str | None, typer.Option(help="Only this licence.")] = None,
    search: Annotated[str | None, typer.Option(help="Only names that contain this.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the meshes of this machine, with their creators and licences."""
    from scene_attack.cli.specs import local_library
    from scene_attack.runs.environment import read_options

    matching = local_library(read_options()).entries(category=category, creator=creator, licence=licence, search=search)
    entries = [entry for entry in matching if entry.kind != "environment"]
    rows = [[e.name, e.title, e.category or "", e.creator or "", e.licence or ""] for e in entries]
    shown = FittedTable(("mesh", "title", "category", "creator", "licence"), rows, spare=("category", "title"))
    print_found(entries, shown, as_json)
    remark(f"{len(rows)} mesh{'' if len(rows) == 1 else 'es'}")


@app.command(
    epilog="Examples: [bold]scene-attack assets fetch[/bold], where there is apt-get\n\n"
    "[bold]scene-attack assets fetch --from sweethome3d-furniture_1.2.2-2_all.deb --from blender-data.deb[/bold]\n\n"
    "[bold]scene-attack assets fetch --from /media/usb/scene-attack[/bold], a cache folder of another machine"
)
def fetch(
    given: Annotated[
        list[Path] | None,
        typer.Option("--from", help="A Debian package, or a folder with packages or with the files themselves."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Bring 800 more models of furniture and five more environment maps into the cache: 150 MB from Debian's archive.

    Without it scenes have the ten models and three maps of the package. Files that are there are checked and kept, so
    that the command may be run again at any time. It needs neither root nor Debian: elsewhere, give the two packages.
    """
    from scene_attack.runs.environment import read_options
    from scene_attack.scenes.fetch import fetch as bring

    cache = read_options().cache_dir
    with err().status("the furniture library and the environment maps") as line:

        def report(text: str) -> None:
            line.update(text)
            if not err().is_terminal:
                remark(text)

        brought = bring(cache, given or [], report)
    text = f"{len(brought)} files brought into {cache}" if brought else f"all files are in {cache}"
    print_found({"folder": str(cache), "brought": brought}, text, as_json)


@app.command(epilog="Example: [bold]scene-attack assets show furniture/grand-piano[/bold]")
def show(mesh: Annotated[str, typer.Argument(help="A name from `assets list`.")], as_json: JsonOption = False) -> None:
    """Show one mesh: its parts, size, hash and creator."""
    from scene_attack.cli.specs import local_library
    from scene_attack.runs.environment import read_options

    library = local_library(read_options())
    loaded, entry = library.mesh(mesh), library.entry(mesh)
    facts: dict[str, Any] = {
        "mesh": mesh,
        "title": None if entry is None else entry.title,
        "licence": None if entry is None else entry.licence,
        "sha256": loaded.sha256,
        "parts": len(loaded.parts),
        "faces": sum(len(part.faces) for part in loaded.parts),
        "vertices": sum(len(part.vertices) for part in loaded.parts),
        "textured parts": sum(part.textured for part in loaded.parts),
        "metallic-roughness parts": sum(part.metallic_roughness is not None for part in loaded.parts),
        "credit": loaded.credit,
    }
    if entry is not None and entry.kind == "upload":
        facts |= {"used": ", ".join(entry.used), "not shown": ", ".join(entry.notes)}
    lines = [[name, "" if value is None else str(value)] for name, value in facts.items()]
    print_found(facts, FittedTable(("", ""), lines), as_json)


@app.command(
    epilog="Examples: [bold]scene-attack assets add chair.obj[/bold], which also sends chair.mtl and the textures that "
    "it names\n\n[bold]scene-attack assets add models.zip --mesh chair.obj --licence 'CC BY 4.0'[/bold]\n\n"
    "[bold]scene-attack assets add garden.hdr[/bold], an environment map"
)
def add(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="A mesh (obj, ply, stl, glb, off, gltf, dae, 3mf), a zip file of one, or a map (hdr, exr)."
        ),
    ],
    kind: Annotated[str | None, typer.Option(help="The format, if the mesh's name does not end in it.")] = None,
    mesh: Annotated[str | None, typer.Option(help="Which file is the mesh, if there are several.")] = None,
    name: Annotated[str | None, typer.Option(help="The name that people see; by default the file's.")] = None,
    up: Annotated[
        str | None, typer.Option(help="The file's axis that points up, y or z; by default its format says.")
    ] = None,
    licence: Annotated[str | None, typer.Option(help="The licence that the mesh may be used under.")] = None,
    credit: Annotated[str | None, typer.Option(help="Whom to name wherever the mesh is shown.")] = None,
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Upload a mesh, with the materials and textures beside it that it names, or an environment map.

    Prints the name to use in a scene, what of the files is used, and what is not.
    """
    from scene_attack.client import operations
    from scene_attack.client.client import Client
    from scene_attack.errors import InvalidRequest
    from scene_attack.scenes.bundle import MAP_KINDS, MESH_KINDS

    forms = {(kind or file.suffix.removeprefix(".")).lower() for file in files}
    if not forms & {*MESH_KINDS, *MAP_KINDS, "zip", "zae"}:
        known = ", ".join((*MESH_KINDS, *MAP_KINDS))
        raise InvalidRequest(
            "--kind", f"{min(forms) or 'no ending'!r} is not a mesh format; it is one of {known}, or a zip file"
        )
    title = name or Path(mesh or files[0]).stem
    request = operations.upload_asset(files, kind, mesh=mesh, name=title, up=up, licence=licence, credit=credit)
    with Client(url) as client:
        entry = client.call(request)
    if as_json:
        print_json(entry)
    else:
        say(entry.name)
        remark(*(f"used: {note}" for note in entry.used), *(f"not shown: {note}" for note in entry.notes))


@app.command(epilog="Example: [bold]scene-attack assets uploads[/bold]")
def uploads(url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """List the meshes that were uploaded to a running service."""
    from scene_attack.client import operations
    from scene_attack.client.client import Client

    with Client(url) as client:
        entries = client.call(operations.list_assets()).items
    rows = [[entry.title, entry.licence, str(entry.triangles), entry.name] for entry in entries]
    print_found(entries, FittedTable(("title", "licence", "triangles", "mesh"), rows), as_json)


@app.command(epilog="Example: [bold]scene-attack assets delete sha256:0f3c…[/bold]")
def delete(
    mesh: Annotated[str, typer.Argument(help="The name that `assets add` printed, or its 64 digits.")],
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Delete an uploaded mesh. A job or campaign that refers to it must be deleted first."""
    from scene_attack.client import operations
    from scene_attack.client.client import Client
    from scene_attack.errors import InvalidRequest

    if not re.fullmatch(r"(sha256:)?[0-9a-f]{64}", mesh):
        raise InvalidRequest("MESH", f"{mesh!r} is not the name of an uploaded mesh, which is sha256: and 64 digits")
    with Client(url) as client:
        client.call(operations.delete_asset(mesh))
    name = f"sha256:{mesh.removeprefix('sha256:')}"
    print_found({"name": name, "deleted": True}, f"{name}  deleted", as_json)


@app.command(epilog="Example: [bold]scene-attack assets environments[/bold]")
def environments(as_json: JsonOption = False) -> None:
    """List the environment maps of this machine, with their creators and licences."""
    from scene_attack.cli.specs import local_library
    from scene_attack.runs.environment import read_options

    library = local_library(read_options())
    uploaded = [entry for entry in library.entries(category="upload") if entry.kind == "environment"]
    entries = [*library.environments(), *uploaded]
    rows = [[entry.name, entry.title, entry.creator, entry.licence, entry.credit or ""] for entry in entries]
    columns = ("map", "title", "creator", "licence", "credit")
    print_found(entries, FittedTable(columns, rows, spare=("credit", "title")), as_json)
