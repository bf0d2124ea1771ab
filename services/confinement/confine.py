"""Confines a process in two steps: a server that only forks, and its children, which each read what is not trusted."""

import os
import resource
from collections.abc import Callable
from dataclasses import dataclass

from services.confinement.landlock import forbid_files
from services.confinement.seccomp import only_compute
from services.confinement.system_calls import die_with_parent, forbid_new_privileges

NOBODY = 65534


@dataclass(frozen=True)
class Limits:
    """Limits of a child: bytes of address space beyond the server's own, and seconds of processor time."""

    memory_bytes: int
    cpu_seconds: int


def address_space() -> int:
    """Bytes of address space that this process has."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def drop_privileges() -> list[str]:
    """Takes the user's rights, the environment and the file system from the process.

    Everything that it needs must be imported and open. Returns what the kernel refuses, in sentences; the rest is done.
    """
    os.environ.clear()
    missing = []
    if os.geteuid() == 0:
        os.setgroups([])
        os.setresgid(NOBODY, NOBODY, NOBODY)
        os.setresuid(NOBODY, NOBODY, NOBODY)
    for what, step in (("new privileges", forbid_new_privileges), ("the file system", forbid_files)):
        missing += _attempt(what, step)
    return missing


def confine(limits: Limits, base: int) -> list[str]:
    """Leaves the process nothing but to compute, to read what is open and to write to it, within the limits.

    `base` is the server's address space. Returns what the kernel refuses, in sentences; the rest is done.
    """
    for kind, most in (
        (resource.RLIMIT_AS, base + limits.memory_bytes),
        (resource.RLIMIT_CPU, limits.cpu_seconds),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_NOFILE, 0),
        (resource.RLIMIT_NPROC, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        lowered = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (lowered, lowered))
    die_with_parent()
    return _attempt("all other system calls", only_compute)


def _attempt(what: str, step: Callable[[], None]) -> list[str]:
    try:
        step()
    except OSError as error:
        return [f"it cannot be refused {what}: {error}"]
    return []
