"""Files that are either the old one or the whole new one, whatever happens to the writer."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a temporary path beside `path`, for the caller to write a file to; on leaving, that file becomes `path`.

    The file and its directory entry are on the disk (fsync) when this returns. If the caller raises, the temporary
    file is removed and `path` stays as it was; a killed process leaves a file that ends in `.part`. Several writers may
    write at once: each file is whole, and the last one stays. Missing directories are made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{secrets.token_hex(8)}.part")
    try:
        yield part
        _sync(part)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _sync(path.parent)


def write(path: Path, data: bytes) -> None:
    """Write a file's bytes atomically; see `replacing`."""
    with replacing(path) as part:
        part.write_bytes(data)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
