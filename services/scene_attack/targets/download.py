"""Fetches a published weights file into the cache, once: streamed, checked, and resumed where it broke off."""

import fcntl
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scene_attack.errors import InvalidRequest
from scene_attack.targets.info import Published, known

ATTEMPTS = 5
"""Connections that are tried before a download is given up; each goes on where the last one ended."""
REACH = 3.0
"""Longest wait for the answer of an address before a job is queued that needs a file from it, seconds."""
CONNECT, READ = 10.0, 30.0
"""Longest waits for a connection and for the next bytes of a download, seconds."""


def fetch(file: Published, folder: Path) -> Path:
    """Returns the path of the file in `folder`, downloaded if it is not there yet.

    Of several processes one downloads and the others wait. Raises InvalidRequest("target.name"), which says where to
    put the file, if it cannot be fetched or is not the published one.
    """
    path = folder / file.name
    folder.mkdir(parents=True, exist_ok=True)
    with _alone(path.with_name(f"{file.name}.lock")):
        if not path.exists():
            _download(file, path)
        if not _digest(path).startswith(file.sha256):
            raise InvalidRequest(
                "target.name",
                f"{path} is not the file of {file.url}: its SHA-256 does not begin with {file.sha256}; replace it by "
                "the published one",
            )
    return path


def check_obtainable(name: str) -> None:
    """Raises InvalidRequest("target.name") for an unknown target, and for one whose weights are missing and cannot be
    fetched: their address does not answer within REACH seconds.
    """
    weights = known(name).weights
    missing = None if weights is None else weights.missing()
    if weights is None or missing is None:
        return
    import httpx  # most processes fetch nothing

    try:
        httpx.head(weights.url, timeout=REACH, follow_redirects=True).raise_for_status()
    except httpx.HTTPError as error:
        trouble = f"{type(error).__name__}: {error}".rstrip(": ")
        raise InvalidRequest(
            "target.name", f"{missing}, which cannot be reached ({trouble}); put the file there"
        ) from error


def _download(file: Published, path: Path) -> None:
    import httpx

    part = path.with_name(f"{file.name}.part")
    trouble = "the connection ended early"
    for _ in range(ATTEMPTS):
        try:
            if not _continued(file.url, part):
                continue
        except httpx.HTTPError as error:
            trouble = f"{type(error).__name__}: {error}".rstrip(": ")
            continue
        if _digest(part).startswith(file.sha256):
            part.replace(path)
            return
        part.unlink()  # an error page, or parts of two versions
        trouble = f"the SHA-256 of what came does not begin with {file.sha256}"
    raise InvalidRequest(
        "target.name", f"its weights cannot be fetched from {file.url} ({trouble}); put the file at {path}"
    )


def _continued(url: str, part: Path) -> bool:
    """Downloads the missing rest of the file `part`; returns whether it is complete. Raises httpx.HTTPError."""
    import httpx

    have = part.stat().st_size if part.exists() else 0
    headers = {"Range": f"bytes={have}-", "Accept-Encoding": "identity"} if have else {"Accept-Encoding": "identity"}
    limits = httpx.Timeout(CONNECT, read=READ)
    with httpx.stream("GET", url, headers=headers, timeout=limits, follow_redirects=True) as answer:
        if answer.status_code == httpx.codes.REQUESTED_RANGE_NOT_SATISFIABLE:  # nothing is missing
            return True
        answer.raise_for_status()
        resumed = answer.status_code == httpx.codes.PARTIAL_CONTENT
        have = have if resumed else 0
        length = answer.headers.get("Content-Length")
        total = None if length is None else have + int(length)
        with part.open("ab" if resumed else "wb") as file:
            for chunk in answer.iter_raw():
                file.write(chunk)
                have += len(chunk)
    return total is None or have == total


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Holds a lock file; a process that ends in any way lets go of it."""
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
