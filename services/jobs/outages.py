"""Outages: errors that pass, because something is away on which jobs and requests depend. They are no job's fault."""

import errno
import re
from dataclasses import dataclass
from typing import Literal

from redis.exceptions import RedisError
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout

_STORAGE = {
    errno.ENOSPC: "the disk of the data directory is full",
    errno.EDQUOT: "the disk quota of the data directory is used up",
    errno.EROFS: "the data directory is read-only",
    errno.EACCES: "the data directory cannot be written",
    errno.EPERM: "the data directory cannot be written",
    errno.EIO: "the disk of the data directory has errors",
    errno.ESTALE: "the data directory is out of reach",
    errno.ENOTCONN: "the data directory is out of reach",
    errno.EREMOTEIO: "the artifact store does not answer",
}
_IN_DATABASE = {
    "disk is full": errno.ENOSPC,
    "No space left": errno.ENOSPC,
    "readonly database": errno.EROFS,
    "disk I/O error": errno.EIO,
}
"""Parts of what SQLite and PostgreSQL say when they cannot write."""
_OS_ERROR = re.compile(r"\(os error (\d+)\)")
"""Error number of the system in the messages of libraries written in Rust, such as safetensors."""


@dataclass(frozen=True)
class Outage:
    """A resource that is away, by its name in `/readyz`, and a sentence for a person."""

    resource: Literal["database", "redis", "storage"]
    detail: str


DISK_FULL = Outage("storage", _STORAGE[errno.ENOSPC])


def outage_of(error: BaseException | None) -> Outage | None:
    """The outage that an error means, or one that caused it; None if it means none."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        outage = _outage(error)
        if outage is not None:
            return outage
        error = error.__cause__ or error.__context__
    return None


def _outage(error: BaseException) -> Outage | None:
    if isinstance(error, RedisError):
        return Outage("redis", "Redis does not answer")
    if isinstance(error, OperationalError | InterfaceError | PoolTimeout):
        number = next((number for part, number in _IN_DATABASE.items() if part in str(error)), None)
        return Outage("database", "the database does not answer") if number is None else _storage(number)
    if isinstance(error, DBAPIError) and error.connection_invalidated:  # e.g. ended by the server, for its silence
        return Outage("database", "the database does not answer")
    if isinstance(error, DBAPIError) and "read-only transaction" in str(error.orig):  # of PostgreSQL: a standby, say
        return Outage("database", "the database is read-only")
    if isinstance(error, OSError):
        return _storage(error.errno)
    match = _OS_ERROR.search(str(error)) if type(error).__name__ == "SafetensorError" else None
    return None if match is None else _storage(int(match[1]))


def _storage(number: int | None) -> Outage | None:
    detail = _STORAGE.get(number or 0)
    return None if detail is None else Outage("storage", detail)
