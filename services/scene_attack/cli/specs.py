"""Requests in files: reads a job or a campaign from a file or from standard input, and adds the meshes of its own."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from scene_attack.client.meshes import Adding, bundle_at, with_meshes_added
from scene_attack.errors import InvalidRequest
from scene_attack.scenes.mesh_arrays import MeshArrays
from scene_attack.strict import NotJson, read_json

if TYPE_CHECKING:
    from scene_attack.options import Options
    from scene_attack.runs.campaign_spec import CampaignSpec
    from scene_attack.runs.spec import JobSpec
    from scene_attack.scenes.library import Library
    from scene_attack.strict import Names


Spec = TypeVar("Spec")


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
    from scene_attack.cli.console import remark
    from scene_attack.runs.spec import names_in

    data, not_added = with_meshes_added(data, folder, to_library(options), remark)
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
