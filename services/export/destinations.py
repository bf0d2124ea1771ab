"""Where an export goes: a folder, or a zip file."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

_COMPRESSED = (".png", ".jpg", ".exr", ".sh3f", ".zip")


@contextmanager
def zipped(file: BinaryIO, folder: str) -> Iterator[Callable[[str, bytes], None]]:
    """Yields a function that adds a file to a zip file under `folder`; the same files give the same bytes."""
    with ZipFile(file, "w") as archive:

        def write(name: str, data: bytes) -> None:
            entry = ZipInfo(f"{folder}/{name}", (1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data, ZIP_STORED if name.endswith(_COMPRESSED) else ZIP_DEFLATED)

        yield write


def into_folder(folder: Path) -> Callable[[str, bytes], None]:
    """A function that writes a file into a folder, which is made; so are the folders of the file's path in it."""
    folder.mkdir(parents=True, exist_ok=True)

    def write(name: str, data: bytes) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)

    return write
