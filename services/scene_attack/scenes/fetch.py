"""Brings the furniture library and the environment maps into the cache: from Debian's packages, or from given files.

Which files they are is in `fetched.sha256`: a file is taken for what its SHA-256 says, wherever it lies. Each is put in
its place by one rename, so that an interrupted run has brought some of them and the next one brings the others.
"""

import fcntl
import hashlib
import io
import shutil
import subprocess
import tarfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from scene_attack import disk
from scene_attack.errors import InvalidRequest, JobFailure

PACKAGES = {"furniture": "sweethome3d-furniture", "environments": "blender-data"}
"""Debian's package that has the files of a folder of the cache."""
PROGRESS_SECONDS = 2.0
Report = Callable[[str], None]


def fetch(cache: Path, given: Iterable[Path], report: Report) -> list[str]:
    """Brings what is missing, and returns the names of the files that it brought, `furniture/Scopia.sh3f` for example.

    `given` are Debian packages (.deb), and folders of them or of the files themselves; without any, apt-get downloads
    the packages. `report` is called with a line of progress now and then. Raises InvalidRequest("--from") if there is
    no such file, if files are still missing, or without apt-get; and JobFailure("asset-missing") if apt-get fails.
    """
    cache.mkdir(parents=True, exist_ok=True)
    with _alone(cache / ".setup.lock"):
        before = missing(cache)
        if not before:
            return []
        if sources := list(given):
            _take(_files_in(sources), cache, before, report)
        else:
            _download(cache, before, report)
        if left := missing(cache):
            raise InvalidRequest(
                "--from",
                f"{', '.join(left)} could not be found: no file has the SHA-256 that this version expects; they are in "
                f"Debian 12's packages {' and '.join(PACKAGES.values())}",
            )
    return before


def missing(cache: Path) -> list[str]:
    """The names of the files that are not in the cache, or are others than the expected ones."""
    return [name for digest, name in _expected().items() if _digest(cache / name) != digest]


def _expected() -> dict[str, str]:
    """Names of the files, relative to the cache, by SHA-256."""
    text = Path(__file__).with_name("fetched.sha256").read_text("ascii")
    return {line.split()[0]: line.split()[1] for line in text.splitlines()}


def _digest(path: Path) -> str | None:
    if not path.is_file():
        return None
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _download(cache: Path, absent: list[str], report: Report) -> None:
    if shutil.which("apt-get") is None:
        raise InvalidRequest(
            "--from",
            f"there is no apt-get here; give the files of Debian 12's packages {' and '.join(PACKAGES.values())}, "
            "which packages.debian.org has, as in --from blender-data_….deb",
        )
    folders = {name.partition("/")[0] for name in absent}
    with TemporaryDirectory(prefix="incoming.", dir=cache) as folder:
        for part in sorted(folders):
            package = Path(folder) / PACKAGES[part]
            package.mkdir()
            _apt_download(package, report)
            _take(_files_in([package]), cache, absent, report)


def _apt_download(folder: Path, report: Report) -> None:
    """Downloads the package that the folder is named after into it."""
    plain = ["apt-get", "-q", "-o", "APT::Sandbox::User=root"]
    if _run([*plain, "download", folder.name], folder, report).returncode == 0:
        return
    # The machine's own package lists may be missing or old, and renewing them needs root: private ones are used.
    private = [*plain, "-o", f"Dir::State={folder}/state", "-o", f"Dir::Cache={folder}/cache"]
    for part in ("state/lists/partial", "cache/archives/partial"):
        (folder / part).mkdir(parents=True)
    for command in (["update"], ["download", folder.name]):
        done = _run([*private, *command], folder, report)
        if done.returncode:
            reason = (done.stdout.strip().splitlines() or ["it said nothing"])[-1]
            detail = f"apt-get cannot download {folder.name}: {reason}; try again, or use --from"
            raise JobFailure("asset-missing", detail)


def _run(command: list[str], folder: Path, report: Report) -> subprocess.CompletedProcess[str]:
    with (folder / "apt.log").open("w+") as log:
        process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=subprocess.STDOUT)
        try:
            while process.poll() is None:
                try:
                    process.wait(PROGRESS_SECONDS)
                except subprocess.TimeoutExpired:
                    size = sum(path.stat().st_size for path in folder.glob("*.deb*"))
                    report(f"{folder.name}: {size / 1e6:.0f} MB downloaded")
        finally:
            process.kill()
            process.wait()
        log.seek(0)
        return subprocess.CompletedProcess(command, process.returncode, log.read())


def _files_in(sources: Iterable[Path]) -> Iterator[tuple[str, Callable[[], bytes]]]:
    """The files of packages and folders: the name of each, and a function that reads it."""
    for source in sources:
        if source.is_dir():
            for path in sorted(path for path in source.rglob("*") if path.is_file()):
                yield from _files_in([path])
        elif not source.is_file():
            raise InvalidRequest("--from", f"there is no file or folder {source}")
        elif source.suffix == ".deb":
            yield from _files_of_package(source)
        else:
            yield source.name, source.read_bytes


def _files_of_package(path: Path) -> Iterator[tuple[str, Callable[[], bytes]]]:
    try:
        with tarfile.open(fileobj=io.BytesIO(_data_of(path.read_bytes()))) as files:
            for member in files:
                if (file := files.extractfile(member) if member.isfile() else None) is not None:
                    yield Path(member.name).name, file.read
    except (tarfile.TarError, ValueError, EOFError) as error:
        raise InvalidRequest("--from", f"{path} is no Debian package that can be read: {error}") from error


def _data_of(package: bytes) -> bytes:
    """The archive `data.tar.*` in a Debian package, which is an archive of `ar`: deb(5)."""
    if not package.startswith(b"!<arch>\n"):
        raise ValueError("it does not begin as one")
    place = 8
    while place + 60 <= len(package):
        head = package[place : place + 60]
        size = int(head[48:58])
        if head.startswith(b"data.tar"):
            return package[place + 60 : place + 60 + size]
        place += 60 + size + size % 2
    raise ValueError("it has no data.tar")


def _take(files: Iterable[tuple[str, Callable[[], bytes]]], cache: Path, absent: list[str], report: Report) -> None:
    """Puts those of the files whose names are in `absent` into their places."""
    wanted = {digest: name for digest, name in _expected().items() if name in absent}
    names = {Path(name).name for name in wanted.values()}
    said = time.monotonic()
    for file_name, read in files:
        if file_name in names and (target := wanted.get(hashlib.sha256(data := read()).hexdigest())) is not None:
            disk.write(cache / target, data)
            if time.monotonic() - said > PROGRESS_SECONDS:
                said = time.monotonic()
                report(f"{target} is there")


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Holds a lock file; of two processes that fetch, one waits for the other."""
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
