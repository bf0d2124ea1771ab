import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import Engine, text
from sqlalchemy.exc import IntegrityError

import scene_attack_service.access.keys  # noqa: F401 - a table of the same database
from scene_attack.errors import InvalidRequest
from scene_attack_service.jobs import database
from scene_attack_service.jobs.database import check_database, connect, migrate
from scene_attack_service.jobs.models import Base
from scene_attack_service.settings import Settings

pytestmark = pytest.mark.slow

SQLITE = pytest.mark.parametrize("database", ["sqlite"], indirect=True)


def test_the_migrations_make_the_tables_of_the_models(engine: Engine) -> None:
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []


def fresh(kind: str, folder: Path, request: pytest.FixtureRequest) -> Settings:
    """Settings with a database of its own that has no tables yet."""
    if kind == "sqlite":
        return Settings(data=folder)
    server = request.getfixturevalue("postgresql_server")
    return Settings(data=folder, database_url=server.url(server.create()))


def with_a_later_revision(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Adds a revision, which gives uploads another column, to those of this version."""
    migrations = folder / "migrations"
    shutil.copytree(database.MIGRATIONS, migrations)
    (migrations / "versions" / "later.py").write_text(
        "import sqlalchemy as sa\n"
        "from alembic import op\n"
        "revision, down_revision = 'later', '0021'\n"
        "def upgrade():\n"
        "    op.add_column('assets', sa.Column('colour', sa.String(16), nullable=False, server_default='grey'))\n"
    )
    monkeypatch.setattr(database, "MIGRATIONS", migrations)


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_later_revision_keeps_what_is_there(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = fresh(kind, tmp_path / "data", request)
    engine = connect(settings)
    migrate(engine, settings)
    with engine.execution_options(writes=True).begin() as connection:
        connection.execute(text("INSERT INTO assets (name) VALUES ('sphere')"))
    with_a_later_revision(tmp_path, monkeypatch)
    assert check_database(engine, settings) == ("0021", "later")
    migrate(engine, settings)
    assert check_database(engine, settings) == ("later", "later")
    with engine.connect() as connection:
        assert connection.execute(text("SELECT name, colour FROM assets")).all() == [("sphere", "grey")]
    engine.dispose()


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_processes_that_start_together_migrate_once(kind: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    settings = fresh(kind, tmp_path, request)
    engines = [connect(settings) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda engine: migrate(engine, settings), engines))
    with engines[0].connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM alembic_version")).scalar() == 1
    for engine in engines:
        engine.dispose()


@pytest.mark.parametrize("url", ["no url at all", "mysql://root:secret@host/name", "nosuch://host"])
def test_a_url_of_another_database_is_bad_input_and_not_shown(url: str) -> None:
    with pytest.raises(InvalidRequest, match="postgresql://") as error:
        connect(Settings(database_url=url))
    assert error.value.field == "SCENE_ATTACK_DATABASE_URL"
    assert "secret" not in str(error.value)


@SQLITE
def test_sqlite_is_opened_for_several_processes(engine: Engine) -> None:
    with engine.connect() as connection:
        pragmas = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "foreign_keys", "busy_timeout")
        }
    assert pragmas == {"journal_mode": "wal", "foreign_keys": 1, "busy_timeout": 10_000}
    with pytest.raises(IntegrityError), engine.begin() as connection:
        connection.execute(text("INSERT INTO artifacts VALUES ('none', 'a', 'b', 'c', 1)"))


@SQLITE
def test_a_transaction_that_writes_holds_the_lock_from_its_start(engine: Engine, tmp_path: Path) -> None:
    other = sqlite3.connect(tmp_path / "jobs.sqlite", timeout=0)
    with engine.execution_options(writes=True).begin() as connection:
        connection.execute(text("SELECT 1"))
        with pytest.raises(sqlite3.OperationalError, match="locked"):
            other.execute("BEGIN IMMEDIATE")
    other.execute("BEGIN IMMEDIATE")
    other.close()
