"""Writes files atomically: after a crash of the writer a file is either the old or the complete new version."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields a temporary path beside `path` for the caller to write to; on exit that file replaces `path`.

    The file and its directory entry are on the disk (fsync) when this returns. If the caller raises, the temporary
    file is removed and `path` stays as it was; a killed process leaves a file that ends in `.part`. Concurrent
    writers are safe: each file is complete, and the last one stays. Missing directories are created.
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
    """Writes a file's bytes atomically; see `replacing`."""
    with replacing(path) as part:
        part.write_bytes(data)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
