"""Meshes in files of this machine, which a request names by their paths."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from services.errors import InvalidRequest

if TYPE_CHECKING:
    from client.api_client import ApiClient
    from services.scenes.bundle import Bundle
    from services.scenes.library import Library
    from services.settings import Settings

Adding = Callable[[Path], tuple[str, Sequence[str]]]
"""Adds the mesh in a file. Returns its name in a scene, and what of the file is not shown. Raises InvalidRequest."""
_PLACES = (
    "scene.objects.*.mesh",
    "jobs.*.scene.objects.*.mesh",
    "grids.*.scenes.meshes.*",
    "grids.*.scenes.*.objects.*.mesh",
)
"""Where a job and a campaign name meshes; a star stands for each item of a list."""


def is_path(mesh: object) -> bool:
    """Whether a spec's mesh is a path, which begins with `./`, `../` or `/`, and not a name."""
    return isinstance(mesh, str) and mesh.startswith(("./", "../", "/"))


def folder_of(spec: str) -> Path:
    """The folder that the paths in the file `spec` are relative to: its own or, for "-", the working directory."""
    return Path.cwd() if spec == "-" else Path(spec).absolute().parent


def read_with_meshes(spec: str, settings: "Settings", seed: int | None = None) -> dict[str, Any]:
    """The request in the file `spec`, as `spec_input.read` has it, with its meshes added to this machine's uploads."""
    from client import spec_input

    return with_meshes_added(spec_input.read(spec, seed), folder_of(spec), to_library(settings))


def with_meshes_added(data: dict[str, Any], folder: Path, add: Adding) -> dict[str, Any]:
    """Adds the meshes that a job or a campaign names by paths relative to `folder`, each file once.

    Returns the request with their names. What a mesh does not show is said on standard error. Raises InvalidRequest,
    with the place in the request, if a file is not there or is no mesh.
    """
    added: dict[str, str] = {}

    def named(mesh: str, place: str) -> str:
        if mesh not in added:
            try:
                added[mesh], notes = add(folder / mesh)
            except InvalidRequest as error:
                raise InvalidRequest(place, f"{mesh}: {error.detail}") from error
            for note in notes:
                _say(f"{mesh}: not shown: {note}")
        return added[mesh]

    for place in _PLACES:
        data = _replaced(data, place.split("."), (), named)
    return data


def to_library(settings: "Settings") -> Adding:
    """Returns what adds a mesh to the uploads of this machine."""

    def add(path: Path) -> tuple[str, Sequence[str]]:
        entry = local_library(settings).add(bundle_at(path, settings), settings)
        return entry.name, entry.notes

    return add


def local_library(settings: "Settings") -> "Library":
    """The meshes and maps of this machine."""
    from services.scenes.library import Library

    return Library(settings.cache_dir, settings.files)


def to_service(client: "ApiClient") -> Adding:
    """Returns what uploads a mesh to a service, and says so on standard error. The name is that of `to_library`."""

    def add(path: Path) -> tuple[str, Sequence[str]]:
        from client.mesh_files import with_files_beside
        from client.request import ApiError
        from services.scenes.about import title_of

        files = with_files_beside([path])
        try:
            entry = client.upload_asset(files, mesh=_chosen(path, files), name=title_of(path))
        except ApiError as error:
            if error.status != 422:
                raise
            raise InvalidRequest("mesh", str(error)) from error
        _say(f"{path.name}: uploaded as {entry['name']}")
        return entry["name"], entry["notes"]

    return add


def bundle_at(path: Path, limits: "Settings") -> "Bundle":
    """Returns the mesh in a file, or in a zip file, with the files beside it that it names. Its title is its name.

    Raises InvalidRequest.
    """
    from client.mesh_files import with_files_beside
    from services.scenes.about import About, title_of
    from services.scenes.sent_files import to_bundle
    from services.scenes.uploads import max_unpacked

    files = [(name, one.read_bytes()) for name, one in with_files_beside([path])]
    return to_bundle(files, None, _chosen(path, files), About(title=title_of(path)), max_unpacked(limits))


def _chosen(path: Path, files: Sequence[object]) -> str | None:
    """Which of the files is the mesh; one alone may be a zip file, which has it inside."""
    return path.name if len(files) > 1 else None


def _replaced(data: Any, steps: Sequence[str], place: tuple[str, ...], named: Callable[[str, str], str]) -> Any:
    """The data with a name for each path at the end of the steps; what has no such place is left to the parser."""
    if not steps:
        return named(data, ".".join(place)) if is_path(data) else data
    step, rest = steps[0], steps[1:]
    if step == "*" and isinstance(data, list | tuple):
        return [_replaced(one, rest, (*place, str(k)), named) for k, one in enumerate(data)]
    if step != "*" and isinstance(data, Mapping) and step in data:
        return {**data, step: _replaced(data[step], rest, (*place, step), named)}
    return data


def _say(words: str) -> None:
    from client.console import err

    err().print(words, markup=False, highlight=False, soft_wrap=True)
