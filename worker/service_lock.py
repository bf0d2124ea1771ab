"""The lock by which one data folder has one `scene-attack serve`: two would take each other's jobs."""

import errno
import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from services.errors import InvalidRequest
from services.logs import logger

FILE = "serve.lock"
_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)

log = logger(__name__)


class ServiceLock:
    """The lock of a data folder, a context manager. No child process inherits it, and it ends with this process.

    Raises InvalidRequest("--data"), with process and address of the other service, if one runs on the folder; also if
    the folder cannot be written. A file system without locks is logged, and the service starts.
    """

    def __init__(self, folder: Path) -> None:
        try:
            # the file is not opened for writing only, or what the other service wrote would be gone
            self._file = (folder / FILE).open("a+")
        except OSError as error:
            detail = f"{folder / FILE} cannot be written ({error.strerror}); name another folder"
            raise InvalidRequest("--data", detail) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            with self._file:
                raise InvalidRequest("--data", f"a service runs on {folder} already, {self._other()}") from error
        except OSError as error:
            if error.errno not in _UNSUPPORTED:
                raise
            log.warning("no lock on the data folder: see to it that no other service uses it", error=error.strerror)
        self.tell(None)

    def tell(self, url: str | None) -> None:
        """Writes this process and its URL, None as long as there is none, for a service that is refused."""
        self._file.truncate(0)  # writing appends
        self._file.write(json.dumps({"pid": os.getpid(), "url": url}))
        self._file.flush()

    def _other(self) -> str:
        self._file.seek(0)
        try:
            other = json.load(self._file)
        except ValueError:  # it is being written
            return "which is just starting; stop it, or name another folder"
        address = "which is starting" if other["url"] is None else f"at {other['url']}"
        return f"process {other['pid']} {address}; use that one, stop it, or name another folder"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: type[BaseException] | None, _error: object, _trace: TracebackType | None) -> None:
        self._file.close()
