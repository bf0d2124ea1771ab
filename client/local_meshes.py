"""Meshes in files of this machine, which a spec names by their paths."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from services.errors import InvalidRequest

if TYPE_CHECKING:
    from services.scenes.bundle import Bundle
    from services.scenes.entries import Entry


def is_path(mesh: object) -> bool:
    """Whether a spec's mesh is a path, which begins with `./`, `../` or `/`, and not a name."""
    return isinstance(mesh, str) and mesh.startswith(("./", "../", "/"))


def with_meshes_added(data: dict[str, Any], spec: str, add: "Callable[[Bundle], Entry]") -> dict[str, Any]:
    """Adds the meshes that a request names by paths, relative to the file `spec` or, for "-", to the working directory.

    Returns the request with their names. What a mesh does not show is said on standard error. Raises InvalidRequest,
    with the place in the request, if a file is not there or is no mesh.
    """
    scene = data.get("scene")
    objects = scene.get("objects") if isinstance(scene, dict) else None
    if not isinstance(objects, list):
        return data
    folder = Path.cwd() if spec == "-" else Path(spec).absolute().parent
    named = []
    for k, thing in enumerate(objects):
        if isinstance(thing, dict) and is_path(thing.get("mesh")):
            try:
                entry = add(bundle_at(folder / thing["mesh"]))
            except InvalidRequest as error:
                raise InvalidRequest(f"scene.objects.{k}.mesh", f"{thing['mesh']}: {error.detail}") from error
            _say(thing["mesh"], entry)
            thing = thing | {"mesh": entry.name}
        named.append(thing)
    return data | {"scene": {**data["scene"], "objects": named}}


def bundle_at(path: Path) -> "Bundle":
    """Returns the mesh in a file, or in a zip file, with the files beside it that it names. Its title is its name.

    Raises InvalidRequest.
    """
    from client.mesh_files import with_files_beside
    from services.scenes.about import About
    from services.scenes.sent_files import to_bundle
    from services.scenes.uploads import max_unpacked
    from services.settings import settings
    from services.written_text import visible

    files = [(name, one.read_bytes()) for name, one in with_files_beside([path])]
    about = About(title=visible(path.stem)[:100])
    return to_bundle(files, None, path.name if len(files) > 1 else None, about, max_unpacked(settings()))


def _say(mesh: str, entry: "Entry") -> None:
    from client.console import err

    for note in entry.notes:
        err().print(f"{mesh}: not shown: {note}", markup=False, highlight=False)
