"""A consistent copy of the data directory while the service runs.

The database is copied first. Files never change and are written before a row names them, so that the files copied
afterwards hold everything that the copied database names.
"""

import shutil
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from services import atomic_write
from services.errors import InvalidRequest, JobFailure

DATABASE = "jobs.sqlite"
FOLDERS = ("artifacts", "assets")
"""Folders of the data directory that are copied. The others hold files of running jobs, which begin again without."""


@dataclass(frozen=True)
class Backup:
    """What a backup holds: the number of files and their bytes, and that of jobs, None without a database."""

    files: int
    size: int
    jobs: int | None


def back_up(data_dir: Path, folder: Path, *, with_database: bool = True, with_files: bool = True) -> Backup:
    """Copies the data directory into `folder`, which is made: its SQLite database, and its artifacts and assets.

    Raises InvalidRequest("FOLDER") if there is something in the folder, and JobFailure("internal") if a file that the
    database names is missing: it was deleted meanwhile, or long ago.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InvalidRequest("FOLDER", f"{folder} is not empty; name one that does not exist yet")
    if with_database and not (data_dir / DATABASE).exists():
        raise InvalidRequest("--data", f"there is no database in {data_dir}")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if with_database:
        _copy_database(data_dir / DATABASE, folder / DATABASE)
    files = [path for name in FOLDERS for path in _files(data_dir / name)] if with_files else []
    size = sum(_copy(path, folder / path.relative_to(data_dir)) for path in files)
    return Backup(len(files), size, _check(folder, with_files) if with_database else None)


def _copy_database(source: Path, goal: Path) -> None:
    with (
        atomic_write.replacing(goal) as part,
        closing(sqlite3.connect(f"{source.as_uri()}?mode=ro", uri=True)) as ours,
        closing(sqlite3.connect(part)) as copy,
    ):
        ours.backup(copy)  # one consistent state, whatever is written meanwhile
        copy.execute("PRAGMA journal_mode=DELETE")  # so that it is one file


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".part"]


def _copy(source: Path, goal: Path) -> int:
    try:
        with atomic_write.replacing(goal) as part:
            shutil.copyfile(source, part)
    except FileNotFoundError:  # deleted meanwhile; `_check` says if the database names it
        return 0
    return goal.stat().st_size


def _check(folder: Path, with_files: bool) -> int:
    """The number of jobs of the copied database. Raises JobFailure if a file that one names is missing."""
    with closing(sqlite3.connect(f"{(folder / DATABASE).as_uri()}?mode=ro", uri=True)) as copy:
        named = [row[0] for row in copy.execute("SELECT DISTINCT sha256 FROM artifacts")]
        [[jobs]] = copy.execute("SELECT count(*) FROM jobs")
    missing = [sha256 for sha256 in named if not (folder / "artifacts" / sha256[:2] / sha256).exists()]
    if missing and with_files:
        detail = f"{len(missing)} of {len(named)} artifacts are missing, such as {missing[0]}; back up again"
        raise JobFailure("internal", detail)
    return int(jobs)
