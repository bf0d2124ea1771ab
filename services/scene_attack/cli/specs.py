"""Requests in files: reads a job or a campaign from a file or from standard input, and adds or uploads the meshes of
this machine that it names by their paths.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.scenes.mesh_arrays import MeshArrays
from scene_attack.strict import NotJson, read_json

if TYPE_CHECKING:
    from scene_attack.client.client import Client
    from scene_attack.client.operations import Answer, Request
    from scene_attack.options import Options
    from scene_attack.runs.campaign_spec import CampaignSpec
    from scene_attack.runs.spec import JobSpec
    from scene_attack.scenes.bundle import Bundle
    from scene_attack.scenes.library import Library
    from scene_attack.strict import Names


Spec = TypeVar("Spec")
Adding = Callable[[Path | MeshArrays], tuple[str, Sequence[str]]]
"""Adds the mesh in a file, or that of arrays. Returns its name in a scene, and the parts that are not shown. Raises
InvalidRequest.
"""
_PLACES = (
    "scene.objects.*.mesh",
    "jobs.*.scene.objects.*.mesh",
    "grids.*.scenes.meshes.*",
    "grids.*.scenes.*.objects.*.mesh",
)
"""Paths of a job's and a campaign's mesh names; a star stands for each item of a list."""
_NAMED = ("furniture/", "primitive/", "sha256:")
"""Prefixes of mesh names that are no file names."""


def read_job(spec: str, options: "Options", seed: int | None = None) -> "JobSpec":
    """The job in the file `spec`, as `read` reads it, with its meshes added to this machine's uploads.

    Raises InvalidFields with every wrong field, and every name that there is not.
    """
    from scene_attack.runs.spec import parse

    data = read(spec, seed)
    if data.keys() & {"grids", "jobs"}:
        raise InvalidRequest("SPEC", f"{spec} is a campaign; `scene-attack campaign run {spec}` runs it")
    return parsed(parse, data, folder_of(spec), options)


def read_campaign(spec: str, options: "Options") -> "CampaignSpec":
    """The campaign in the file `spec`; as `read_job`."""
    from scene_attack.runs.campaign_spec import parse

    data = read(spec)
    if "scene" in data:
        raise InvalidRequest("SPEC", f"{spec} is a job; `scene-attack run {spec}` runs it")
    return parsed(parse, data, folder_of(spec), options)


def parsed(parse: Callable[[Any, "Names"], Spec], data: dict[str, Any], folder: Path, options: "Options") -> Spec:
    """The job or campaign in JSON data, with the meshes below `folder` added to this machine's uploads."""
    from scene_attack.runs.spec import names_in

    data, not_added = with_meshes_added(data, folder, to_library(options))
    return parse(data, names_in(local_library(options), not_read=not_added))


def read(path: str, seed: int | None = None) -> dict[str, Any]:
    """The JSON object in the file `path`, or on standard input for "-". A given `seed` replaces the spec's seed.

    Raises InvalidRequest("SPEC") for a file that does not exist or does not hold a JSON object.
    """
    try:
        text = sys.stdin.read() if path == "-" else Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise InvalidRequest("SPEC", f"cannot read {path}: {reason}; give a JSON file, or - for stdin") from error
    try:
        data = read_json(text)
    except NotJson as error:
        raise InvalidRequest("SPEC", f"{path} cannot be read: {error}") from error
    if not isinstance(data, dict):
        raise InvalidRequest("SPEC", f'{path} holds a JSON {type(data).__name__}; a spec is an object: {{"scene": …}}')
    if seed is not None:
        data["seed"] = seed
    return data


def folder_of(spec: str) -> Path:
    """The folder that the paths in the file `spec` are relative to: its own or, for "-", the working directory."""
    return Path.cwd() if spec == "-" else Path(spec).absolute().parent


def with_meshes_added(data: dict[str, Any], folder: Path, add: Adding) -> tuple[dict[str, Any], dict[str, str]]:
    """Adds the meshes that a job or a campaign names by paths relative to `folder`, or has as arrays, each once.

    Returns the request with their names, and of each mesh that could not be added, because there is no such file or it
    is no mesh, the reason. Those are left as they are, and so is a file's name that is written as no path. What a mesh
    does not show is said on standard error.
    """
    added: dict[str, str] = {}
    not_added: dict[str, str] = {}

    def named(mesh: str, _: str) -> str:
        if not isinstance(mesh, MeshArrays) and not is_path(mesh):
            if not mesh.startswith(_NAMED) and (folder / mesh).is_file():
                not_added[mesh] = f"there is no mesh {mesh!r}; a file beside the spec is written './{mesh}'"
        elif mesh not in added and mesh not in not_added:
            try:
                added[mesh], notes = add(mesh if isinstance(mesh, MeshArrays) else folder / mesh)
            except InvalidRequest as error:
                not_added[mesh] = f"{mesh}: {error.detail}"
            else:
                from scene_attack.cli.console import remark

                for note in notes:
                    remark(f"{mesh}: not shown: {note}")
        return added.get(mesh, mesh)

    for place in _PLACES:
        data = _replaced(data, place.split("."), named)
    return data, not_added


def sent(
    data: dict[str, Any], folder: Path, client: "Client", request: Callable[[dict[str, Any]], "Request[Answer]"]
) -> "Answer":
    """The service's answer to a request of data, with the meshes that it names by paths uploaded.

    Raises InvalidFields with every wrong field: a mesh that was not uploaded, and what the service finds beside it.
    """
    from scene_attack.client.errors import ApiError

    data, not_added = with_meshes_added(data, folder, to_service(client))
    wrong: dict[str, InvalidRequest] = {}

    def refused(mesh: str, field: str) -> str:
        if mesh in not_added:
            wrong[field] = InvalidRequest(field, not_added[mesh])
        return mesh

    for place in _PLACES:
        _replaced(data, place.split("."), refused)
    try:
        return client.call(request(data))
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


def to_library(options: "Options") -> Adding:
    """Returns a function that adds a mesh to the uploads of this machine."""

    def add(mesh: Path | MeshArrays) -> tuple[str, Sequence[str]]:
        bundle = mesh.bundle if isinstance(mesh, MeshArrays) else bundle_at(mesh, options)
        entry = local_library(options).add(bundle, options)
        return entry.name, entry.notes

    return add


def local_library(options: "Options") -> "Library":
    """The meshes and maps of this machine."""
    from scene_attack.scenes.library import Library

    return Library(options.cache_dir, options.files)


def bundle_at(path: Path, limits: "Options") -> "Bundle":
    """Returns the mesh in a file, or in a zip file, with the files beside it that it names. Its title is its name.

    Raises InvalidRequest.
    """
    from scene_attack.client.mesh_files import with_files_beside
    from scene_attack.scenes.bundle import About, title_of
    from scene_attack.scenes.uploads import max_unpacked, to_bundle

    files = [(name, file.read_bytes()) for name, file in with_files_beside([path])]
    return to_bundle(
        files, None, path.name if len(files) > 1 else None, About(title=title_of(path)), max_unpacked(limits)
    )


def to_service(client: "Client") -> Adding:
    """Returns a function that uploads a mesh to a service, with names as in `to_library`, and tells stderr."""

    def add(path: Path) -> tuple[str, Sequence[str]]:
        from scene_attack.cli.console import remark
        from scene_attack.client import operations
        from scene_attack.client.errors import ApiError
        from scene_attack.scenes.bundle import title_of

        try:
            entry = client.call(operations.upload_asset([path], name=title_of(path)))
        except ApiError as error:
            if error.status != 422:
                raise
            raise InvalidRequest("mesh", str(error)) from error
        remark(f"{path.name}: uploaded as {entry.name}")
        return entry.name, entry.notes

    return add
