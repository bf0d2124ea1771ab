"""Opens the database and its transactions, migrates its tables, and tells outages from faults.

The database is SQLite on one machine, and PostgreSQL for several. An outage is an error that passes, because something
is away on which jobs and requests depend. It is no job's fault.
"""

import errno
import fcntl
import json
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Literal
from urllib.parse import quote

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from redis.exceptions import RedisError
from sqlalchemy import Connection, Engine, create_engine, event, func, inspect, make_url, select, text
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import ArgumentError, DatabaseError, DBAPIError, InterfaceError, NoSuchModuleError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.orm import Session

from scene_attack.disk import NotOurs, make_private
from scene_attack.errors import InvalidRequest, without_folders
from scene_attack.extras import extra
from scene_attack_service.settings import Settings

MIGRATIONS = Path(__file__).parent / "migrations"
LOCK_SECONDS = 10.0
"""Longest wait of a transaction for another one's lock; SQLite has one writer at a time. A process that waits uses no
processor time, and must not be taken to hang: it waits for a quarter of that time at most.
"""
CONNECT_SECONDS = 5
"""Longest wait for PostgreSQL's answer to a new connection."""
_SQLITE_FILES = {"jobs.sqlite", "jobs.sqlite-shm", "jobs.sqlite-wal", "migrate.lock", "reserve"}
_DATABASE_FILES = _SQLITE_FILES | {"database.dump", "serve.lock"}
IN_DATA_FOLDER = frozenset(_DATABASE_FILES | {"artifacts", "assets", "checkpoints", "running", "demo", "service.log"})
"""Names that a data directory may hold, also one that a backup or the demonstration made."""
_MIGRATING = 0x5CE4EA77
"""The number of the lock that PostgreSQL gives one migration at a time."""


class UnusableDatabase(InvalidRequest):
    """The settings' database is none that this version can use: what is wrong with it, and what to do."""

    def __init__(self, settings: Settings, reason: str, remedy: str) -> None:
        self.reason = reason
        self.remedy = remedy
        # the URL itself may have a password and is not shown
        place = str(_file(settings)) if settings.database_url is None else "SCENE_ATTACK_DATABASE_URL"
        super().__init__("database", f"{place}: {reason}; {remedy}")


def connect(settings: Settings) -> Engine:
    """Returns an engine for the settings' database, which is SQLite in the data directory unless a URL is set.

    Raises InvalidRequest if the URL is none of SQLite or PostgreSQL, the driver is not installed, or the data directory
    cannot be made or holds other things.
    """
    # A file that has gone is not made again: it may come back, and what was written meanwhile would be lost.
    url = settings.database_url or f"sqlite:///file:{quote(str(_file(settings)))}?mode=rw&uri=true"
    kind = _kind(url)
    options: dict[str, Any] = {}
    if kind == "postgresql":
        options = {"connect_args": {"connect_timeout": CONNECT_SECONDS, "application_name": "scene-attack"}}
    with extra("postgresql", "PostgreSQL", "SCENE_ATTACK_DATABASE_URL"):
        # Numbers that are not finite are refused, because JSON cannot represent them.
        engine = create_engine(url, json_serializer=partial(json.dumps, allow_nan=False), pool_pre_ping=True, **options)
    wait = min(LOCK_SECONDS, settings.stall_seconds / 4)
    try:
        _make_data_folder(settings.data_dir)  # also beside PostgreSQL: the files of running jobs are there
    except OSError as error:
        detail = f"the folder {settings.data_dir} cannot be made ({error.strerror}); name another one"
        raise InvalidRequest("SCENE_ATTACK_DATA", detail) from error
    if kind == "sqlite":
        event.listen(engine, "connect", partial(_tune_sqlite, wait))
        event.listen(engine, "begin", _begin_sqlite)
    else:
        event.listen(engine, "do_connect", partial(_connect_postgresql, wait))
    return engine


def _make_data_folder(folder: Path) -> None:
    try:
        make_private(folder, IN_DATA_FOLDER)
    except NotOurs as error:
        detail = (
            f"{folder} holds other things, such as {error}, and would be closed to other users; name a folder for the "
            f"service alone, or close this one yourself: chmod 700 {folder}"
        )
        raise InvalidRequest("SCENE_ATTACK_DATA", detail) from error


def _file(settings: Settings) -> Path:
    return settings.data_dir / "jobs.sqlite"


def _kind(url: str) -> str:
    try:
        kind = make_url(url).get_backend_name()
    except (ArgumentError, NoSuchModuleError):
        kind = ""
    if kind not in ("sqlite", "postgresql"):  # the URL itself may have a password and is not shown
        detail = "must be a URL such as postgresql://user:password@host:5432/name, or sqlite:////absolute/path"
        raise InvalidRequest("SCENE_ATTACK_DATABASE_URL", detail)
    return kind


def _connect_postgresql(wait: float, _dialect: Any, _record: Any, _words: Any, arguments: dict[str, Any]) -> Any:
    from scene_attack_service.jobs.answer_limit import limited  # its driver is an extra

    return limited(wait, arguments)


def _tune_sqlite(wait: float, connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # _begin_sqlite issues BEGIN
    cursor = connection.cursor()
    for pragma in (f"busy_timeout={round(1000 * wait)}", "journal_mode=WAL", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that reads first and writes later fails at once, without waiting, if another one wrote in between.
    # A transaction that will write therefore takes the lock at its start.
    options = connection.get_execution_options()
    writes = options.get("writes", False)
    if writes:
        # NORMAL never corrupts under WAL, but a power cut may undo the last commits. That a job was accepted must last
        # (FULL); a result that was undone is computed again.
        connection.exec_driver_sql(f"PRAGMA synchronous={'FULL' if options.get('durable', False) else 'NORMAL'}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


Clock = Callable[[], datetime]
READS_SQLITE = Lock()
"""SQLite hands Python's lock back and forth at every row. Threads that read at the same time spend more on that than on
reading: eight lists at once take a quarter less of the processor one after another.
"""


class Database:
    """Opens transactions. The time of every write is the database's; tests replace it by `clock`."""

    def __init__(self, engine: Engine, clock: Clock | None = None) -> None:
        self.engine = engine
        self._reading: AbstractContextManager[Any] = READS_SQLITE if engine.dialect.name == "sqlite" else nullcontext()
        self._writes = engine.execution_options(writes=True)
        self._lasting = engine.execution_options(writes=True, durable=True)
        self._about = {"clock": clock}

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A session for reading."""
        with self._reading, Session(self.engine, expire_on_commit=False, info=self._about) as session:
            yield session

    @contextmanager
    def write(self, *, durable: bool = False) -> Iterator[Session]:
        """A transaction. One that is `durable` is on the disk when it ends, also after a power cut."""
        engine = self._lasting if durable else self._writes
        with Session(engine, expire_on_commit=False, info=self._about) as session, session.begin():
            session.connection()  # waits for the lock of SQLite, so that times that are read now are those of the write
            yield session

    def ping(self) -> None:
        """Raises SQLAlchemyError if the database does not answer."""
        with self.read() as session:
            session.execute(text("SELECT version_num FROM alembic_version"))  # SQLite reads the file for this


def now(session: Session) -> datetime:
    """The time by the database's clock, which is one for all machines: theirs may differ by more than a lease."""
    clock: Clock | None = session.info["clock"]
    if clock is not None:
        return clock()
    if session.get_bind().dialect.name == "sqlite":  # it is part of this process, and has this machine's clock
        return datetime.now(UTC)
    moment: datetime = session.scalars(select(func.clock_timestamp())).one()
    return moment.astimezone(UTC)


def migrate(engine: Engine, settings: Settings) -> None:
    """Migrates the tables to the newest revision. Processes that start together wait for one another.

    Raises as `check_database`.
    """
    with _alone(engine, settings):
        check_database(engine, settings)
        _migrate(engine)


def _migrate(engine: Engine) -> None:
    with engine.execution_options(writes=True).begin() as connection:
        be_patient(connection)
        if engine.dialect.name == "postgresql":
            # held until the transaction ends
            connection.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": _MIGRATING})
        config = _config()
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def be_patient(connection: Connection) -> None:
    """Lets a connection's transaction take as long as it does, as those of commands may. Afterwards it closes."""
    if connection.dialect.name != "postgresql":
        return
    driver: Any = connection.connection.driver_connection
    driver.answer_seconds = None
    connection.detach()
    for limit in ("lock_timeout", "idle_in_transaction_session_timeout"):
        connection.exec_driver_sql(f"SET LOCAL {limit} = 0")


def check_database(engine: Engine, settings: Settings) -> tuple[str | None, str]:
    """Returns the revision of the tables, None if there are none yet, and the newest revision.

    Raises UnusableDatabase for a file that is no database or is damaged, and for tables of another program or of
    another version; OperationalError if the database does not answer.
    """
    scripts = ScriptDirectory.from_config(_config())
    newest = scripts.get_current_head()
    assert newest is not None
    try:
        with engine.connect() as connection:
            # in this order: another process may commit all tables and their revision in between
            tables = set(inspect(connection).get_table_names()) - {"alembic_version"}
            revision = MigrationContext.configure(connection).get_current_revision()
    except OperationalError:
        raise
    except DatabaseError as error:
        reason = without_folders(str(error.__cause__ or error)).splitlines()[0]
        raise UnusableDatabase(settings, reason, "restore it, or name another one") from error
    if revision is None and tables:
        reason = f"it has tables of another program, such as {min(tables)}"
        raise UnusableDatabase(settings, reason, "name an empty database")
    if revision not in {None, *(script.revision for script in scripts.walk_revisions())}:
        reason = f"its tables are of revision {revision}, which this version does not know"
        remedy = "install the version of scene-attack that wrote them, or name another database"
        raise UnusableDatabase(settings, reason, remedy)
    return revision, newest


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    return config


@contextmanager
def _alone(engine: Engine, settings: Settings) -> Iterator[None]:
    """Holds a lock in the data directory, which the processes of a SQLite database share."""
    if engine.dialect.name != "sqlite":
        yield
        return
    _make_data_folder(settings.data_dir)
    with (settings.data_dir / "migrate.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if settings.database_url is None:
            _file(settings).touch()
        yield


_INSERT: dict[str, Any] = {"sqlite": sqlite.insert, "postgresql": postgresql.insert}


def insert(session: Session, table: type) -> Any:
    """An INSERT into a model's table, of the dialect of the session's database."""
    return _INSERT[session.get_bind().dialect.name](table)


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
        return Outage("database", "the database does not answer") if number is None else _storage_outage(number)
    if isinstance(error, DBAPIError) and error.connection_invalidated:  # e.g. ended by the server, for its silence
        return Outage("database", "the database does not answer")
    if isinstance(error, DBAPIError) and "read-only transaction" in str(error.orig):  # of PostgreSQL: a standby, say
        return Outage("database", "the database is read-only")
    if isinstance(error, OSError):
        return _storage_outage(error.errno)
    match = _OS_ERROR.search(str(error)) if type(error).__name__ == "SafetensorError" else None
    return None if match is None else _storage_outage(int(match[1]))


def _storage_outage(number: int | None) -> Outage | None:
    detail = _STORAGE.get(number or 0)
    return None if detail is None else Outage("storage", detail)
