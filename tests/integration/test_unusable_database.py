"""The commands that open the database, on one that they cannot use: one sentence, and nothing is added to it."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from scene_attack_service.checkup import database
from scene_attack_service.settings import Settings
from tests.integration.machine import Machine

pytestmark = pytest.mark.integration

COMMANDS = ("serve --port 0", "api --port 0", "worker", "keys create alice", "keys list", "backup")


def no_database(file: Path) -> None:
    file.write_text("once upon a time\n" * 100)


def foreign(file: Path) -> None:
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("CREATE TABLE cats (name TEXT)")


def of_revision(revision: str, file: Path) -> None:
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("CREATE TABLE alembic_version (version_num TEXT)")
        connection.execute("INSERT INTO alembic_version VALUES (?)", [revision])
        connection.commit()


def tables(file: Path) -> list[str] | bytes:
    """What a database has, or the bytes of what is none."""
    try:
        with closing(sqlite3.connect(file)) as connection:
            return list(connection.iterdump())
    except sqlite3.DatabaseError:
        return file.read_bytes()


UNUSABLE: dict[str, tuple[Callable[[Path], None], str]] = {
    "no database": (no_database, "file is not a database; restore it, or name another one"),
    "foreign": (foreign, "it has tables of another program, such as cats; name an empty database"),
    **{
        kind: (
            partial(of_revision, revision),
            f"its tables are of revision {revision}, which this version does not know; install the version of "
            "scene-attack that wrote them, or name another database",
        )
        for kind, revision in (("newer", "9999"), ("older", "0019"))
    },
}


@pytest.mark.parametrize(
    ("kind", "commands"),
    [("no database", COMMANDS), ("foreign", ("keys list",)), ("newer", COMMANDS[:1]), ("older", COMMANDS[-1:])],
)
def test_a_database_that_cannot_be_used_is_one_sentence(
    kind: str, commands: tuple[str, ...], tmp_path: Path, redis_url: str
) -> None:
    make, said = UNUSABLE[kind]
    folder = tmp_path / "data"
    folder.mkdir(mode=0o700)
    file = folder / "jobs.sqlite"
    make(file)
    before = tables(file)
    machine = Machine(tmp_path / "home", SCENE_ATTACK_REDIS_URL=redis_url)
    for command in commands:
        words = [*command.split(), *([str(tmp_path / "copy")] if command == "backup" else [])]
        code, _, stderr = machine.run(*words, "--data", str(folder))
        assert code == 2, command
        lines = [line for line in stderr.splitlines() if not line.startswith("{")]  # the log
        assert lines == [f"scene-attack: bad input: database: {file}: {said}"], command
        assert tables(file) == before, command
    assert not (tmp_path / "copy").exists()
    [finding] = database(Settings(data=folder))  # of doctor
    assert f"{finding.text}; {finding.remedy}" == f"sqlite: {said}"
