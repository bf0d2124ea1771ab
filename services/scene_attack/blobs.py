"""Files by name, in a folder or in an object store such as S3. Each is written, or replaced, whole or not at all.

An object store is whatever fsspec has a file system for. Its address and its keys are those of that file system's own
environment variables (S3: `AWS_ENDPOINT_URL`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`).
"""

import errno
import math
import os
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedIOBase
from pathlib import Path
from typing import Any, cast

from scene_attack import disk
from scene_attack.errors import InvalidRequest
from scene_attack.extras import MissingExtra, extra

CONNECT_SECONDS = 5
READ_SECONDS = 20
"""Time to wait for an answer of an object store, seconds; a request is made up to five times."""
YOUNG_SECONDS = 1800.0
"""Age below which an object is not removed. Objects have the time of their writing only."""
SETTING = "SCENE_ATTACK_ARTIFACT_URL"


class Folder:
    """Files in a folder; a name may have folders of its own. Every operation raises OSError if it cannot be done."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def write(self, name: str, data: bytes) -> None:
        """Writes a file, and waits until it is on the disk."""
        disk.write(self._folder / name, data)

    def open(self, name: str) -> BufferedIOBase:
        """Opens a file for reading. Raises FileNotFoundError."""
        return (self._folder / name).open("rb")

    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""
        return (self._folder / name).is_file()

    def names(self) -> list[str]:
        """The names of all files, sorted; those that a killed process left half-written are none."""
        files = (path for path in self._folder.rglob("*") if path.is_file() and path.suffix != ".part")
        return sorted(str(path.relative_to(self._folder)) for path in files)

    def keep(self, name: str) -> bool:
        """Says that a file is wanted. Returns False if it has to be written, as there is none or it is about to go."""
        try:
            os.utime(self._folder / name)
        except FileNotFoundError:
            return False
        return True

    def remove(self, name: str, unwanted_seconds: float) -> None:
        """Removes a file if it was neither written nor wanted within the last `unwanted_seconds`, if there is one."""
        path = self._folder / name
        aside = path.with_name(f"{path.name}.{secrets.token_hex(8)}.part")
        with suppress(FileNotFoundError):
            if _age(path) < unwanted_seconds:
                return
            path.rename(aside)  # whoever wants it from now on writes it anew
            if _age(aside) < unwanted_seconds:  # it was wanted just before
                aside.rename(path)
            else:
                aside.unlink()

    def delete(self, name: str) -> None:
        """Removes a file at once, if there is one. Nobody may be about to write it."""
        (self._folder / name).unlink(missing_ok=True)


def _age(path: Path) -> float:
    return time.time() - path.stat().st_mtime


class Objects:
    """Objects under a prefix of an object store. An object appears when all its bytes have arrived."""

    def __init__(self, files: Any, prefix: str) -> None:
        self._files = files
        self._prefix = prefix.rstrip("/")

    def write(self, name: str, data: bytes) -> None:
        """Writes an object."""
        try:
            self._files.pipe_file(f"{self._prefix}/{name}", data)
        except Exception as error:  # also of a bucket that is missing
            raise _away(error) from error

    def open(self, name: str) -> BufferedIOBase:
        """Opens a copy of an object. The copy has no name: it is gone when it is closed."""
        copy = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes it
        try:
            with _errors():
                self._files.get_file(f"{self._prefix}/{name}", f"/proc/self/fd/{copy.fileno()}")
            copy.seek(0)
        except BaseException:
            copy.close()
            raise
        return cast(BufferedIOBase, copy)

    def exists(self, name: str) -> bool:
        """Whether there is an object of this name."""
        with _errors():
            return bool(self._files.exists(f"{self._prefix}/{name}"))

    def names(self) -> list[str]:
        """The names of all objects."""
        with _errors():
            paths = self._files.find(self._prefix)
        return sorted(path.removeprefix(f"{self._prefix}/") for path in paths)

    def keep(self, name: str) -> bool:
        """Says that an object is wanted: one that is no longer young is written again, which makes it young."""
        return self._age(name) < YOUNG_SECONDS

    def remove(self, name: str, unwanted_seconds: float) -> None:
        """Removes an object that is unwanted."""
        age = self._age(name)
        if max(unwanted_seconds, YOUNG_SECONDS) <= age < math.inf:
            with _errors():
                self._files.rm_file(f"{self._prefix}/{name}")

    def delete(self, name: str) -> None:
        """Removes an object at once."""
        with suppress(FileNotFoundError), _errors():
            self._files.rm_file(f"{self._prefix}/{name}")

    def _age(self, name: str) -> float:
        """The time in seconds since an object was written, infinite if there is none."""
        try:
            with _errors():
                return time.time() - float(self._files.modified(f"{self._prefix}/{name}").timestamp())
        except FileNotFoundError:
            return math.inf


Blobs = Folder | Objects


def blobs(place: Path | str, part: str) -> Blobs:
    """The files of one part of a place: a folder, or the URL of one or of an object store.

    Raises InvalidRequest if the URL is of no store that can be reached with what is installed.
    """
    if isinstance(place, Path):
        return Folder(place / part)
    scheme, separator, rest = place.partition("://")
    if not separator or scheme == "file":
        if not rest.startswith("/"):
            raise InvalidRequest(SETTING, "must be a URL such as s3://bucket/folder or file:///absolute/folder")
        return Folder(Path(rest) / part)
    with extra("s3", f"a store at {scheme}://", SETTING):
        from fsspec.core import url_to_fs

    # What other machines write must be seen, so nothing is remembered of a listing.
    options: dict[str, Any] = {"use_listings_cache": False, "skip_instance_cache": True}
    if scheme == "s3":
        options["config_kwargs"] = {"connect_timeout": CONNECT_SECONDS, "read_timeout": READ_SECONDS}
    try:
        files, prefix = url_to_fs(place, **options)
    except ImportError as error:
        detail = f'a store at {scheme}:// needs the extra "s3": pip install "scene-attack[s3]"'
        raise MissingExtra(SETTING, detail) from error
    except ValueError as error:
        detail = f"must be a URL such as s3://bucket/folder or file:///absolute/folder: {str(error)[:200]}"
        raise InvalidRequest(SETTING, detail) from error
    return Objects(files, f"{prefix.rstrip('/')}/{part}")


@contextmanager
def _errors() -> Iterator[None]:
    """Turns what a store's client raises into OSError: a missing object stays FileNotFoundError."""
    try:
        yield
    except FileNotFoundError:
        raise
    except Exception as error:
        raise _away(error) from error


def _away(error: Exception) -> OSError:
    return OSError(errno.EREMOTEIO, f"the artifact store does not answer: {type(error).__name__}")
