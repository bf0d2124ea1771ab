"""Checks of an installation: the requirements of the service, their state, and a remedy for each that fails.

Drivers and compiled code, which may crash a process, are tried in a process of their own, `python -m
scene_attack.cli.checkup`, which prints a line of JSON for each trial as soon as it has ended.
"""

import json
import os
import secrets
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import Any, Literal

from packaging.requirements import Requirement
from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError

from scene_attack.cli.settings import unknown_variables
from scene_attack.errors import InvalidRequest, JobFailure, printable, summary, without_folders
from scene_attack.process import options, program
from scene_attack.runs.extensions import set_up
from scene_attack_service.settings import Settings

Level = Literal["ok", "warn", "fail"]
GIGABYTE = 10**9
LITTLE_SPACE = 5 * GIGABYTE
NO_SPACE = GIGABYTE // 2
TRIAL_SECONDS = 180.0
"""Longest time for the process that tries drivers and compiled code; the kernels may be compiled first."""
SETUP = "run scripts/setup"


@dataclass(frozen=True)
class Finding:
    """The result of a check: `fail` means that the service cannot run, `warn` that it runs with something missing."""

    subject: str
    level: Level
    text: str
    remedy: str = ""


def checkup(settings: Settings) -> Iterator[Finding]:
    """Makes all checks, the quick ones first. None of them changes anything but the kernels, which may be compiled."""
    checks: list[Callable[[Settings], Iterator[Finding]]] = [
        packages,
        variables,
        folders,
        store,
        database,
        redis,
        meshes,
        additions,
        trial,
    ]
    for check in checks:
        yield from check(settings)


def packages(_: Settings) -> Iterator[Finding]:
    """Whether the packages are there that the project needs, in versions that it runs with."""
    try:
        requirements = [Requirement(text) for text in distribution("scene-attack").requires or []]
    except PackageNotFoundError:
        yield Finding("packages", "warn", "scene-attack itself is not installed as a package", SETUP)
        return
    bad = []
    for need in requirements:
        if need.marker is None or need.marker.evaluate({"extra": ""}):
            try:
                installed = version(need.name)
            except PackageNotFoundError:
                bad.append(f"{need.name} is missing")
                continue
            if not need.specifier.contains(installed, prereleases=True):
                bad.append(f"{need.name} is {installed}, not {need.specifier}")
    python = ".".join(map(str, sys.version_info[:3]))
    if bad:
        yield Finding("packages", "fail", "; ".join(bad), SETUP)
    else:
        yield Finding("packages", "ok", f"Python {python}, scene-attack {version('scene-attack')} and what it needs")


def variables(_: Settings) -> Iterator[Finding]:
    """Whether each variable that looks like a setting is one."""
    for name, error in unknown_variables(os.environ).items():
        yield Finding(name, "warn", error, "mend its name, or remove it")


def store(settings: Settings) -> Iterator[Finding]:
    """Whether the store of artifacts takes an object, gives it out and deletes it; a data directory is no store."""
    if settings.artifact_url is None:
        return
    from scene_attack.blobs import blobs

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


def folders(settings: Settings) -> Iterator[Finding]:
    """Whether the data folder and the cache can be written, their disks have space, and no other user can read data."""
    yield _folder("data folder", settings.data_dir, "SCENE_ATTACK_DATA", private=True)
    yield _folder("cache folder", settings.cache_dir, "SCENE_ATTACK_CACHE", private=False)


def _folder(subject: str, folder: Path, setting: str, *, private: bool) -> Finding:
    there = next(parent for parent in (folder, *folder.parents) if parent.exists())
    space = shutil.disk_usage(there).free
    free = f"{folder}: {space / GIGABYTE:.1f} GB free"
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        remedy = f"give it to the user with the number {os.getuid()}, or name another one by {setting}"
        return Finding(subject, "fail", f"{there} cannot be written", remedy)
    if space < LITTLE_SPACE:
        remedy = f"make space, or name another folder by {setting}"
        return Finding(subject, "fail" if space < NO_SPACE else "warn", free, remedy)
    if private and there == folder and stat.S_IMODE(there.stat().st_mode) & 0o077:
        return Finding(subject, "warn", f"{folder}: other users of this machine may read it", f"chmod 700 {folder}")
    return Finding(subject, "ok", free if there == folder else f"{free}, will be made")


def database(settings: Settings) -> Iterator[Finding]:
    """Whether the database answers, and whether its tables are those of this version."""
    from scene_attack_service.jobs.database import UnusableDatabase, check_database, connect

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
    from scene_attack_service.jobs.queue import Queue, connect
    from scene_attack_worker.stack import find_server

    if settings.redis_url is None:
        try:
            yield Finding("Redis", "ok", f"embedded, {find_server()}")
        except JobFailure as error:
            yield Finding(
                "Redis", "fail", error.detail, "install redis-server, or name a server by SCENE_ATTACK_REDIS_URL"
            )
        return
    try:
        client = connect(settings.redis_url)
        with client:
            workers = Queue(client).live_workers()
            server_version = client.info("server")["redis_version"]
    except (RedisError, ValueError) as error:
        yield Finding("Redis", "fail", str(error), "start it, or mend SCENE_ATTACK_REDIS_URL")
    else:
        yield Finding("Redis", "ok", f"version {server_version}; workers alive: {workers}")


def meshes(settings: Settings) -> Iterator[Finding]:
    """Whether the furniture library and the environment maps were fetched."""
    from scene_attack.scenes.library import Library

    library = Library(settings.cache_dir, settings.data_dir)  # uploads, which a store may have, are not asked for
    furniture = sum(entry.kind == "furniture" for entry in library.entries())
    maps = len(library.environments()) - 1  # one is computed
    level: Level = "ok" if furniture and maps else "warn"
    text = f"{furniture} models of furniture, {maps} environment maps"
    yield Finding("meshes", level, text, "" if level == "ok" else f"{SETUP}; until then scenes have primitives only")


def additions(settings: Settings) -> Iterator[Finding]:
    """Extensions, and networks of one's own, that were left out."""
    from scene_attack.extensions import loaded_extensions
    from scene_attack.runs.extensions import set_up, target_folders

    set_up(settings)
    for kind, loaded in (("extension", loaded_extensions()), ("target", target_folders())):
        for addition in loaded:
            if addition.error is None:
                yield Finding(f"{kind} {addition.name}", "ok", "loaded")
            else:
                yield Finding(
                    f"{kind} {addition.name}",
                    "warn",
                    without_folders(addition.error),
                    "mend it, and restart the service",
                )


def trial(settings: Settings) -> Iterator[Finding]:
    """Tries the device, OpenGL, the kernels and the default network, in another process."""
    command = program("scene_attack.cli.checkup")
    environ = os.environ | settings.environ()
    try:
        done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=TRIAL_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        text = f"drivers and kernels did not answer within {TRIAL_SECONDS:g} seconds"
        yield Finding("trial", "fail", text, "try SCENE_ATTACK_GL=osmesa, and SCENE_ATTACK_KERNEL=torch")
        return
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            fields: dict[str, Any] = json.loads(line)
            yield Finding(**fields)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        text = f"the process that tries drivers and kernels ended with status {done.returncode}: {last}"
        yield Finding(
            "trial", "fail", without_folders(text), "try SCENE_ATTACK_GL=osmesa, and SCENE_ATTACK_KERNEL=torch"
        )


# What follows runs in the process of its own.


def main() -> None:
    """Tries everything; an error of one thing does not keep the others from being tried."""
    set_up(Settings())
    _try("device", _device, "set SCENE_ATTACK_DEVICE to auto or cpu")
    _try("OpenGL", _opengl, "install what it names; SCENE_ATTACK_GL says which platform is tried")
    _try("kernels", _kernels, "install g++, then run scripts/setup")
    _try("default network", _network, "run scripts/setup: its weights come with a package")


def _try(subject: str, attempt: Callable[[], tuple[str, str]], remedy: str) -> None:
    try:
        level, text = attempt()
    except InvalidRequest as error:
        level, text = "fail", f"{error.field}: {error.detail}"
    except JobFailure as error:
        level, text = "fail", error.detail
    except Exception as error:
        level, text = "fail", summary(error)
    fields = {"subject": subject, "level": level, "text": printable(text), "remedy": "" if level == "ok" else remedy}
    print(json.dumps(fields), flush=True)


def _device() -> tuple[str, str]:
    from scene_attack.process import describe, device

    return "ok", describe(device())


def _opengl() -> tuple[str, str]:
    """Creates an OpenGL context, which draws and reads back once."""
    from scene_attack.rendering.opengl.context import gl_backend

    return "ok", gl_backend()


def _kernels() -> tuple[str, str]:
    from scene_attack.rendering.kernels import compiled

    backend = compiled.backend()
    compiler = shutil.which("g++")
    if backend != "torch":
        return "ok", backend
    if options().kernel == "torch":
        return "ok", "torch, as SCENE_ATTACK_KERNEL says"
    return "warn", f"none, so torch does their work some ten times slower; compiler: {compiler or 'none'}"


def _network() -> tuple[str, str]:
    from scene_attack.runs.spec import DEFAULT_TARGET
    from scene_attack.targets import registry

    registry.load(DEFAULT_TARGET)
    return "ok", f"{DEFAULT_TARGET} is loaded"


if __name__ == "__main__":
    main()
