"""The meshes of one's own in a request: those that it names by paths, or has as arrays, are added to a library or
uploaded to a service, and stand in it by their names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scene_attack.client.mesh_files import with_files_beside
from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.options import DEFAULTS, Options
from scene_attack.scenes.bundle import About, Bundle, title_of
from scene_attack.scenes.mesh_arrays import MeshArrays
from scene_attack.scenes.uploads import max_unpacked, to_bundle

if TYPE_CHECKING:
    from scene_attack.client.operations import Answer, Request
    from scene_attack.client.schemas import Uploaded

Adding = Callable[[Path | MeshArrays], tuple[str, Sequence[str]]]
"""Adds the mesh in a file, or that of arrays. Returns its name in a scene, and the parts that are not shown. Raises
InvalidRequest.
"""
Call = Callable[["Request[Any]"], Any]
"""Sends a request to a service and returns its answer, as `Client.call` does."""
_SCENE = "source.file"
_OF_A_SCENE = (_SCENE, "objects.*.mesh", "fixed.*.mesh")
_PLACES = (
    *(f"{scene}.{part}" for scene in ("scene", "jobs.*.scene", "grids.*.scenes.*") for part in _OF_A_SCENE),
    "grids.*.scenes.meshes.*",
)
"""Paths of a job's and a campaign's mesh names; a star stands for each item of a list."""
_NAMED = ("furniture/", "primitive/", "sha256:")
"""Prefixes of mesh names that are no file names."""


def with_meshes_added(
    data: dict[str, Any], folder: Path, add: Adding, say: Callable[[str], None]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Adds the meshes that a job or a campaign names by paths relative to `folder`, or has as arrays, each once.

    Returns the request with their names, and of each mesh that could not be added, because there is no such file or it
    is no mesh, the reason. Those are left as they are, and so is a file's name that is written as no path. `say` is
    told what a mesh does not show.
    """
    added: dict[str, str] = {}
    not_added: dict[str, str] = {}

    def named(mesh: str, place: str) -> str:
        if not isinstance(mesh, MeshArrays) and not is_path(mesh):
            if not mesh.startswith(_NAMED) and (folder / mesh).is_file():
                not_added[mesh] = f"there is no mesh {mesh!r}; a file of one's own is written './{mesh}'"
        elif mesh not in added and mesh not in not_added:
            try:
                added[mesh], notes = add(mesh if isinstance(mesh, MeshArrays) else folder / mesh)
            except InvalidRequest as error:
                not_added[mesh] = f"{mesh}: {error.detail}"
            else:
                if not place.endswith(_SCENE):  # a scene shows more, and says what it does not
                    for note in notes:
                        say(f"{mesh}: not shown: {note}")
        return added.get(mesh, mesh)

    for place in _PLACES:
        data = _replaced(data, place.split("."), named)
    return data, not_added


def sent(
    data: dict[str, Any],
    folder: Path,
    call: Call,
    request: Callable[[dict[str, Any]], Request[Answer]],
    say: Callable[[str], None] = lambda _: None,
) -> Answer:
    """The service's answer to a request of data. The meshes that it names by paths relative to `folder`, or has as
    arrays, are uploaded where the service lacks them; `say` is told which, and what they do not show.

    Raises InvalidFields with every wrong field: a mesh that was not uploaded, and what the service finds beside it.
    """
    from scene_attack.client.errors import ApiError

    data, not_added = with_meshes_added(data, folder, _to_service(call, say), say)
    wrong: dict[str, InvalidRequest] = {}

    def refused(mesh: str, field: str) -> str:
        if mesh in not_added:
            wrong[field] = InvalidRequest(field, not_added[mesh])
        return mesh

    for place in _PLACES:
        _replaced(data, place.split("."), refused)
    try:
        answer: Answer = call(request(data))
        return answer
    except ApiError as error:
        if error.status != 422 or not wrong:
            raise
        answered = (InvalidRequest(entry["field"], entry["detail"]) for entry in error.problem.get("errors", ()))
        raise InvalidFields([*wrong.values(), *(entry for entry in answered if entry.field not in wrong)]) from error


def _replaced(data: Any, steps: Sequence[str], named: Callable[[str, str], str], place: str = "") -> Any:
    """The data with `named(text, its place)` for each text at the end of the steps; the rest is left to the parser."""
    if not steps:
        return named(data, place) if isinstance(data, str) else data
    step, rest = steps[0], steps[1:]
    if step == "*" and isinstance(data, list | tuple):
        return [_replaced(item, rest, named, f"{place}.{k}") for k, item in enumerate(data)]
    if step != "*" and isinstance(data, Mapping) and step in data:
        return {**data, step: _replaced(data[step], rest, named, f"{place}.{step}".removeprefix("."))}
    return data


def is_path(mesh: object) -> bool:
    """Whether a spec's mesh is a path, which begins with `./`, `../` or `/`, and not a name."""
    return isinstance(mesh, str) and mesh.startswith(("./", "../", "/"))


def bundle_at(path: Path, limits: Options) -> Bundle:
    """Returns the mesh in a file, or in a zip file, with the files beside it that it names. Its title is its name.

    Raises InvalidRequest.
    """
    files = [(name, file.read_bytes()) for name, file in with_files_beside([path])]
    return to_bundle(
        files, None, path.name if len(files) > 1 else None, About(title=title_of(path)), max_unpacked(limits)
    )


def _to_service(call: Call, say: Callable[[str], None]) -> Adding:
    """Returns a function that uploads a mesh, unless the service has it."""
    from scene_attack.client import operations
    from scene_attack.client.errors import ApiError

    def add(mesh: Path | MeshArrays) -> tuple[str, Sequence[str]]:
        bundle = mesh.bundle if isinstance(mesh, MeshArrays) else bundle_at(mesh, DEFAULTS)
        try:
            entry = call(operations.get_asset(bundle.sha256))
        except ApiError as error:
            if error.status != 404:
                raise
            entry = upload(mesh)
        return entry.name, entry.notes

    def upload(mesh: Path | MeshArrays) -> Uploaded:
        try:
            if isinstance(mesh, MeshArrays):
                uploaded: Uploaded = call(operations.upload_asset([("mesh.ply", mesh.bundle.data)]))
                return uploaded
            entry: Uploaded = call(operations.upload_asset([mesh], name=title_of(mesh)))
        except ApiError as error:
            if error.status != 422:
                raise
            raise InvalidRequest("mesh", str(error)) from error
        say(f"{mesh.name}: uploaded as {entry.name}")
        return entry

    return add
