"""Opens the database and migrates its tables."""

import fcntl
import json
from functools import partial
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event, make_url

from services.settings import Settings

MIGRATIONS = Path(__file__).parent / "migrations"
BUSY_MILLISECONDS = 10_000
"""How long a transaction waits for another one's lock; SQLite has one writer at a time."""


def connect(settings: Settings) -> Engine:
    """Returns an engine for the settings' database, which is SQLite in the data directory unless a URL is set."""
    url = settings.database_url or f"sqlite:///{settings.data_dir / 'jobs.sqlite'}"
    # Numbers that are not finite are refused, because JSON cannot represent them.
    engine = create_engine(url, json_serializer=partial(json.dumps, allow_nan=False), pool_pre_ping=True)
    if make_url(url).get_backend_name() == "sqlite":
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        event.listen(engine, "connect", _tune_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _tune_sqlite(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # _begin_sqlite issues BEGIN
    cursor = connection.cursor()
    # NORMAL never corrupts under WAL; a power cut may undo the last commits, and an undone job runs again.
    for pragma in (
        f"busy_timeout={BUSY_MILLISECONDS}",
        "journal_mode=WAL",
        "synchronous=NORMAL",
        "foreign_keys=ON",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that reads first and writes later fails at once, without waiting, if another one wrote in between.
    # A transaction that will write therefore takes the lock at its start.
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def migrate(engine: Engine, settings: Settings) -> None:
    """Migrates the tables to the newest revision. Processes that start together wait for one another."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    with (settings.data_dir / "migrate.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with engine.execution_options(writes=True).begin() as connection:
            config = Config()
            config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
