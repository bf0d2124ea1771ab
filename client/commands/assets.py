"""The commands `assets`: the meshes and environment maps that a request can name."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from client.commands.options import DEFAULT_URL, JsonOption, UrlOption

if TYPE_CHECKING:
    from services.scenes.library import Library

app = typer.Typer(help="The meshes and environment maps that scenes are made of.", no_args_is_help=True)

FORMATS = ("obj", "ply", "stl", "glb", "off")


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
    from client.console import err, out, print_json, table

    entries = _library().entries(category=category, creator=creator, licence=licence, search=search)
    if as_json:
        print_json([entry.model_dump(mode="json") for entry in entries])
        return
    rows = [[e.name, e.title, e.category or "", e.creator or "", e.licence or ""] for e in entries]
    out().print(table(("mesh", "title", "category", "creator", "licence"), rows))
    err().print(f"{len(rows)} meshes", highlight=False)


@app.command(epilog="Example: [bold]scene-attack assets show furniture/grand-piano[/bold]")
def show(mesh: Annotated[str, typer.Argument(help="A name from `assets list`.")], as_json: JsonOption = False) -> None:
    """Show one mesh: its parts, size, hash and creator."""
    from client.console import out, print_json, table

    loaded = _library().mesh(mesh)
    facts: dict[str, Any] = {
        "mesh": mesh,
        "sha256": loaded.sha256,
        "parts": len(loaded.parts),
        "faces": sum(len(part.faces) for part in loaded.parts),
        "vertices": sum(len(part.vertices) for part in loaded.parts),
        "textured parts": sum(part.textured for part in loaded.parts),
        "metallic-roughness parts": sum(part.metallic_roughness is not None for part in loaded.parts),
        "credit": loaded.credit,
    }
    if as_json:
        print_json(facts)
    else:
        out().print(table(("", ""), [[name, "" if value is None else str(value)] for name, value in facts.items()]))


@app.command(epilog="Example: [bold]scene-attack assets add teapot.obj[/bold]")
def add(
    file: Annotated[Path, typer.Argument(help="An obj, ply, stl, glb or off file.")],
    kind: Annotated[str | None, typer.Option(help="The format, if the file's name does not end in it.")] = None,
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Upload a mesh to a running service; prints the name to use in a scene."""
    from client.api_client import ApiClient
    from client.console import err, out, print_json
    from services.errors import InvalidRequest

    form = (kind or file.suffix.removeprefix(".")).lower()
    if form not in FORMATS:
        raise InvalidRequest(
            "--kind", f"{form or 'no ending'!r} is not a mesh format; it is one of {', '.join(FORMATS)}"
        )
    if not file.is_file():
        raise InvalidRequest("FILE", f"there is no file {file}")
    with ApiClient(url) as client:
        entry = client.add_asset(file, form)
    if as_json:
        print_json(entry)
    else:
        out().print(entry["name"], markup=False, highlight=False)
        for note in entry.get("notes", ()):
            err().print(note, markup=False, highlight=False)


@app.command(epilog="Example: [bold]scene-attack assets uploads[/bold]")
def uploads(url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """List the meshes that were uploaded to a running service."""
    from client.api_client import ApiClient
    from client.console import out, print_json, table

    with ApiClient(url) as client:
        entries = client.assets()
    if as_json:
        print_json(entries)
    else:
        rows = [[entry["name"], entry["title"], str(entry["triangles"])] for entry in entries]
        out().print(table(("mesh", "title", "triangles"), rows))


@app.command(epilog="Example: [bold]scene-attack assets delete sha256:0f3c…[/bold]")
def delete(
    mesh: Annotated[str, typer.Argument(help="The name that `assets add` printed, or its 64 digits.")],
    url: UrlOption = DEFAULT_URL,
) -> None:
    """Delete an uploaded mesh. A job or campaign that refers to it must be deleted first."""
    from client.api_client import ApiClient
    from services.errors import InvalidRequest

    if not re.fullmatch(r"(sha256:)?[0-9a-f]{64}", mesh):
        raise InvalidRequest("MESH", f"{mesh!r} is not the name of an uploaded mesh, which is sha256: and 64 digits")
    with ApiClient(url) as client:
        client.delete_asset(mesh)


@app.command(epilog="Example: [bold]scene-attack assets environments[/bold]")
def environments(as_json: JsonOption = False) -> None:
    """List the environment maps."""
    from client.console import out, print_json

    names = [getattr(found, "name", found) for found in _library().environments()]
    if as_json:
        print_json(names)
    else:
        out().print("\n".join(map(str, names)), markup=False, highlight=False)


def _library() -> "Library":
    from services.scenes.library import Library
    from services.settings import settings

    return Library(settings().cache_dir, settings().files)
