"""A real PostgreSQL for tests: one server on loopback for all of them."""

from collections.abc import Iterator
from contextlib import contextmanager

import psycopg
from psycopg.sql import SQL, Identifier

from benchmarks.postgresql import Server
from benchmarks.postgresql import free_port as free_port
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.models import Base
from scene_attack_service.settings import Settings

TIME_ZONE = "America/St_Johns"
"""Of the server, and so of its sessions: none that a test could agree with by chance."""
OPTIONS = {
    "timezone": TIME_ZONE,
    "fsync": "off",
    "synchronous_commit": "off",
    "full_page_writes": "off",
    "shared_buffers": "32MB",
}


class Postgresql(Server):
    """A running server."""

    def empty(self, name: str) -> None:
        """Deletes all rows: ten times as fast as to make another database."""
        tables = [Identifier(table) for table in Base.metadata.tables]
        with psycopg.connect(self.url(name), autocommit=True) as connection:
            connection.execute(SQL("TRUNCATE {}").format(SQL(", ").join(tables)))

    def migrated(self) -> str:
        """Creates a database with the tables and returns its name."""
        name = self.create()
        engine = connect(Settings(database_url=self.url(name)))
        migrate(engine, Settings(database_url=self.url(name)))
        engine.dispose()
        return name


@contextmanager
def running() -> Iterator[Postgresql]:
    """Starts a server of its own, and ends it on leaving."""
    server = Postgresql(OPTIONS)
    try:
        server.start()
        server.wait()
        yield server
    finally:
        server.stop()
