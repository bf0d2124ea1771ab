"""Files and folders: atomic writes, after which a file is the old or the complete new version whatever crashes; and
folders that no other user of the machine can look into.
"""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


OTHERS = stat.S_IRWXG | stat.S_IRWXO


class NotOurs(Exception):
    """A folder holds what is not ours, and others may look into it: it is not closed to them."""


def make_private(folder: Path, ours: frozenset[str]) -> None:
    """Makes a folder with mode 0700. Of one that is there and ours it takes the rights of group and others away.

    A folder that every user shares (it has the sticky bit, as /tmp has) stays as it is, and so does one that belongs to
    somebody else or cannot be changed. What lies in a private folder is private whatever its own mode.

    `ours` are the names of what a folder of ours may hold. Raises NotOurs where one that would have to be closed holds
    anything else, as a home directory or / would; names that begin with a dot and lost+found do not count.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.stat()
    if status.st_uid == os.geteuid() and status.st_mode & OTHERS and not status.st_mode & stat.S_ISVTX:
        foreign = sorted(path.name for path in folder.iterdir() if path.name not in ours and _counts(path.name))
        if foreign:
            raise NotOurs(foreign[0])
        with suppress(OSError):  # a file system that is read-only, or knows no modes
            folder.chmod(stat.S_IMODE(status.st_mode) & ~OTHERS)


def _counts(name: str) -> bool:
    return not name.startswith(".") and name != "lost+found"
