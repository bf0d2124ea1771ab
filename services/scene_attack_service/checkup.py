"""The service's part of `doctor`: its variables, data folder, store, database and Redis."""

import os
import secrets
from collections.abc import Iterator

from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError

from scene_attack.blobs import blobs
from scene_attack.cli.checkup import Finding, Level, folder_finding
from scene_attack.errors import InvalidRequest, JobFailure, without_folders
from scene_attack_service.jobs import queue
from scene_attack_service.jobs.database import UnusableDatabase, check_database, connect
from scene_attack_service.settings import Settings, read_settings, unknown_variables


def checks() -> Iterator[Finding]:
    """Makes the checks, with the settings of this environment."""
    settings = read_settings()
    for check in (variables, data, store, database, redis):
        yield from check(settings)


def variables(_: Settings) -> Iterator[Finding]:
    """Whether each variable that looks like a setting is one."""
    for name, error in unknown_variables(os.environ).items():
        yield Finding(name, "warn", error, "mend its name, or remove it")


def data(settings: Settings) -> Iterator[Finding]:
    """Whether the data folder can be written, its disk has space, and no other user can read it."""
    yield folder_finding("data folder", settings.data_dir, "SCENE_ATTACK_DATA", private=True)


def store(settings: Settings) -> Iterator[Finding]:
    """Whether the store of artifacts takes an object, gives it out and deletes it; a data directory is no store."""
    if settings.artifact_url is None:
        return
    name = f"doctor-{secrets.token_hex(8)}"
    try:
        objects = blobs(settings.artifact_url, "artifacts")
        objects.write(name, b"doctor")
        with objects.open(name) as file:
            same = file.read() == b"doctor"
        objects.delete(name)
    except InvalidRequest as error:
        yield Finding("artifact store", "fail", f"{error.field}: {error.detail}", "mend it")
    except OSError as error:
        remedy = "start it, or mend SCENE_ATTACK_ARTIFACT_URL and the variables of its client, for S3 those of AWS"
        yield Finding("artifact store", "fail", error.strerror or str(error), remedy)
    else:
        level: Level = "ok" if same else "fail"
        text = "takes objects and gives them out" if same else "gives out another object than it was given"
        yield Finding("artifact store", level, text)


def database(settings: Settings) -> Iterator[Finding]:
    """Whether the database answers, and whether its tables are those of this version."""
    file = settings.data_dir / "jobs.sqlite"
    if settings.database_url is None and not file.exists():
        yield Finding("database", "ok", f"SQLite, will be made at {file}")
        return
    remedy = "start it, or mend SCENE_ATTACK_DATABASE_URL" if settings.database_url else f"restore {file}, or move it"
    try:
        engine = connect(settings)
        try:
            revision, newest = check_database(engine, settings)
        finally:
            engine.dispose()
    except UnusableDatabase as error:
        yield Finding("database", "fail", f"{engine.dialect.name}: {error.reason}", error.remedy)
    except InvalidRequest as error:
        yield Finding("database", "fail", f"{error.field}: {error.detail}", "mend it")
    except SQLAlchemyError as error:
        yield Finding("database", "fail", without_folders(str(error.__cause__ or error)).splitlines()[0], remedy)
    else:
        kind = engine.dialect.name
        if revision is None or revision == newest:
            yield Finding("database", "ok", f"{kind}, tables of revision {revision or newest}")
        else:
            text = f"{kind}: its tables are of revision {revision}, not {newest}"
            yield Finding("database", "warn", text, "the next start migrates them; make a backup first")


def redis(settings: Settings) -> Iterator[Finding]:
    """Whether Redis answers, or can be started."""
    if settings.redis_url is None:
        try:
            yield Finding("Redis", "ok", f"embedded, {queue.find_server()}")
        except JobFailure as error:
            yield Finding(
                "Redis", "fail", error.detail, "install redis-server, or name a server by SCENE_ATTACK_REDIS_URL"
            )
        return
    try:
        client = queue.connect(settings.redis_url)
        with client:
            workers = queue.Queue(client).live_workers()
            server_version = client.info("server")["redis_version"]
    except (RedisError, ValueError) as error:
        yield Finding("Redis", "fail", str(error), "start it, or mend SCENE_ATTACK_REDIS_URL")
    else:
        yield Finding("Redis", "ok", f"version {server_version}; workers alive: {workers}")
