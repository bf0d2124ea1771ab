"""Finds the files that a mesh on this machine refers to, so that they are sent with it."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.bundle import BESIDE, MAX_FILES
from scene_attack.scenes.reading.companion_files import named_files


def with_files_beside(given: Sequence[Path]) -> list[tuple[str, Path]]:
    """Returns the given files and those beside them that they name, each with its path relative to their folder.

    A file is found by the path that names it, from the folder of the file that does so or of the mesh, or else by its
    name in the mesh's folder, in any case of letters. Files elsewhere are left out: a mesh that somebody else made may
    name any file of this machine. Raises InvalidRequest("FILE", …) if a given file is not there, or there are too many.
    """
    for path in given:
        if not path.is_file():
            raise InvalidRequest("FILE", f"there is no file {path}")
    folder = Path(os.path.commonpath([path.absolute().parent for path in given]))
    paths = {path.resolve(): os.path.relpath(path.absolute(), folder) for path in given}
    waiting = list(given)
    while waiting:
        path = waiting.pop()
        kind = _ending(path)
        if kind not in BESIDE and kind != "mtl":
            continue
        for name in (file.name for file in named_files(path.read_bytes(), kind)):
            beside = _beside(name, (path.parent, folder))
            if beside is None or not beside.resolve().is_relative_to(folder.resolve()):
                continue
            if _ending(beside) in _SENT and beside.resolve() not in paths:
                paths[beside.resolve()] = os.path.relpath(beside.absolute(), folder)
                waiting.append(beside)
    if len(paths) > MAX_FILES:
        raise InvalidRequest("FILE", f"the mesh names {len(paths):,} files; at most {MAX_FILES:,} are taken")
    return [(name, path) for path, name in paths.items()]


_SENT = {ending for endings in BESIDE.values() for ending in endings}


def _beside(name: str, folders: Iterable[Path]) -> Path | None:
    written = Path(name.replace("\\", "/"))
    for folder in folders:
        for path in (folder / written, folder / written.name):
            if path.is_file():
                return path
            for other in path.parent.glob("*") if path.parent.is_dir() else ():
                if other.name.lower() == path.name.lower() and other.is_file():
                    return other
    return None


def _ending(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")
