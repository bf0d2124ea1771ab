"""The meshes and the map of a scene as files of an export, and the library that they make on another machine.

`furniture/<slug>.sh3f` is a furniture library of one model, and a file of `environments` a map, as in the cache or the
package. `uploads/<sha256>/` has the files of an upload as they were sent, `uploads/<sha256>.json` what was said of it.
"""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import BaseModel, ValidationError

from scene_attack.errors import InvalidRequest, printable
from scene_attack.options import Options
from scene_attack.scenes.bundle import About, bundle_of
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.scene_file import upload_of
from scene_attack.scenes.uploads import max_unpacked

ASSETS = "assets"
"""The folder in an export."""


class _Sent(BaseModel):
    """An upload: its kind, the path of its mesh or map in its folder, and what its sender said of it."""

    kind: str
    mesh: str
    about: About


def write_assets(scene: Scene, library: Library, write: Callable[[str, bytes], None]) -> None:
    """Calls `write` with the path and the bytes of each file. Primitives and the uniform map have none.

    Raises JobFailure("asset-missing") for an asset whose files are missing or changed.
    """
    for name in sorted(
        {upload_of(thing.mesh) for thing in (*scene.objects, *scene.fixed)} | {scene.lights.environment.map}
    ):
        slug = name.partition("/")[2]
        if (archive := library.furniture_archive(name)) is not None:
            write(f"{ASSETS}/furniture/{slug}.sh3f", archive)
        elif (file := library.map_file(name)) is not None:
            write(f"{ASSETS}/environments/{file.name}", file.read_bytes())
        elif (bundle := library.upload(name)) is not None:
            files, place = bundle.files(), f"{ASSETS}/uploads/{bundle.sha256}"
            sent = _Sent(kind=bundle.kind, mesh=next(iter(files)), about=bundle.about)
            write(f"{place}.json", sent.model_dump_json(indent=1).encode() + b"\n")
            for path, data in files.items():
                write(f"{place}/{path}", data)


@contextmanager
def exported_library(export: Path, limits: Options) -> Iterator[Library]:
    """A library of the assets in an export and of no others. Uploads are read again, as when they were sent.

    Raises InvalidRequest("directory") for an upload that is damaged, or that this version reads otherwise.
    """
    with TemporaryDirectory() as scratch:  # a library writes what it derives beside its files
        place = Path(scratch) / ASSETS
        check_plain(export / ASSETS, max_unpacked(limits))
        shutil.copytree(export / ASSETS, place)
        library = Library(place, place / "data", packaged=False)
        for file in sorted((place / "uploads").glob("*.json")):
            _add_again(file, library, limits)
        yield library


def check_plain(folder: Path, max_bytes: float = inf) -> None:
    """Raises InvalidRequest("directory") unless all in a folder of an export are folders and files of at most
    `max_bytes`, and no links: a folder that somebody sent is not to make this machine read its other files."""
    for path in (folder, *sorted(folder.rglob("*"))):
        if path.is_symlink() or not (path.is_dir() or path.is_file()):
            raise InvalidRequest("directory", f"{printable(str(path))} is neither a file nor a folder")
        if path.is_file() and path.stat().st_size > max_bytes:
            raise InvalidRequest("directory", f"{printable(str(path))} has more than {max_bytes:,} bytes")


def _add_again(file: Path, library: Library, limits: Options) -> None:
    folder, name = file.with_suffix(""), f"sha256:{file.stem}"
    try:
        sent = _Sent.model_validate_json(file.read_bytes())
        files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        added = library.add(bundle_of(files, sent.kind, sent.mesh, sent.about), limits).name
    except (InvalidRequest, ValidationError) as error:
        message = error.detail if isinstance(error, InvalidRequest) else f"{file.name} is damaged"
        raise InvalidRequest("directory", f"the upload {name} in {ASSETS}/uploads cannot be read: {message}") from error
    if added != name:
        raise InvalidRequest(
            "directory",
            f"the files in {ASSETS}/uploads/{file.stem} are not those that were uploaded, or another version of "
            "scene-attack read them; `provenance.versions` of result.json says which",
        )
