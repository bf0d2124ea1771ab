"""Takes rights from the running process before it reads bytes that are not trusted (Linux).

A process is confined in two steps: a server that only forks, and its children, which each read what is not trusted. The
file system is taken from the process, and TCP where the kernel can (Landlock, Linux 5.13 and later); then a seccomp
filter for a process that computes refuses all but a few system calls with EPERM.

What is left is memory, time, and reading and writing what is open already: no file can be opened, no socket made, no
process or program started, no other process traced or signalled.
"""

import ctypes
import os
import platform
import resource
import signal
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_GET_VERSION = 1
_BENEATH = 1
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
"""Number of rights over files that each version knows: they are the lowest bits of a mask."""
_TO_READ = 0b1100
"""The rights to read a file and to list a folder."""


def forbid_files(readable: Sequence[Path] = (), writable: Sequence[Path] = ()) -> None:
    """Refuses this thread, for ever, to open, list, make, move or remove any file, and to use TCP. What is beneath the
    folders `readable` it may read, and beneath `writable` do anything with.

    What is open stays open. Raises OSError if the kernel has no Landlock, or a folder is not there.
    """
    version = syscall(_CREATE_RULESET, 0, 0, _GET_VERSION)
    files = (1 << _FILE_RIGHTS[min(version, max(_FILE_RIGHTS))]) - 1
    tcp = 0b11 if version >= 4 else 0  # to bind, to connect
    rights = struct.pack("=QQ", files, tcp) if version >= 4 else struct.pack("=Q", files)
    forbid_new_privileges()
    ruleset = syscall(_CREATE_RULESET, ctypes.c_char_p(rights), len(rights), 0)
    try:
        for folders, granted in ((readable, _TO_READ), (writable, files)):
            for folder in folders:
                opened = os.open(folder, os.O_PATH)
                try:
                    rule = struct.pack("=Qi", granted, opened)
                    syscall(_ADD_RULE, ruleset, _BENEATH, ctypes.c_char_p(rule), 0)
                finally:
                    os.close(opened)
        syscall(_RESTRICT_SELF, ruleset, 0)  # a right that is named, and given by no rule, is refused
    finally:
        os.close(ruleset)


_AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
"""linux/audit.h. The numbers below are of arch/x86/entry/syscalls/syscall_64.tbl and asm-generic/unistd.h."""
ALLOWED = {
    "read": (0, 63),
    "write": (1, 64),
    "close": (3, 57),
    "fstat": (5, 80),
    "lseek": (8, 62),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "munmap": (11, 215),
    "brk": (12, 214),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sched_yield": (24, 124),
    "mremap": (25, 216),
    "madvise": (28, 233),
    "nanosleep": (35, 101),
    "getpid": (39, 172),
    "exit": (60, 93),
    "gettimeofday": (96, 169),
    "getrusage": (98, 165),
    "sysinfo": (99, 179),
    "sigaltstack": (131, 132),
    "gettid": (186, 178),
    "futex": (202, 98),
    "sched_getaffinity": (204, 123),
    "restart_syscall": (219, 128),
    "clock_gettime": (228, 113),
    "clock_nanosleep": (230, 115),
    "exit_group": (231, 94),
    "getrandom": (318, 278),
}
"""System calls that are left, with their numbers on x86_64 and aarch64."""

_PR_SET_SECCOMP, _MODE_FILTER = 22, 2
_LOAD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
_NUMBER, _ARCHITECTURE = 0, 4
"""Offsets in struct seccomp_data."""
_KILL, _REFUSE, _ALLOW = 0x80000000, 0x00050001, 0x7FFF0000
"""SECCOMP_RET_KILL_PROCESS, SECCOMP_RET_ERRNO with EPERM, SECCOMP_RET_ALLOW."""


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("filter", ctypes.c_char_p))


def only_compute() -> None:
    """Refuses this thread, for ever, every system call but those of ALLOWED.

    Raises OSError if the kernel has no seccomp filters or the processor is not in _AUDIT_ARCH.
    """
    code = program(platform.machine())
    forbid_new_privileges()  # without it only root may set a filter
    prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(_Program(len(code) // 8, code)))


def program(machine: str) -> bytes:
    """The filter in the kernel's BPF, 8 bytes an instruction."""
    if machine not in _AUDIT_ARCH:
        raise OSError(f"there is no list of system calls for {machine}")
    column = list(_AUDIT_ARCH).index(machine)
    numbers = [row[column] for row in ALLOWED.values()]
    instructions = [
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_JUMP_IF_EQUAL, 1, 0, _AUDIT_ARCH[machine]),
        (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, _NUMBER),
        *((_JUMP_IF_EQUAL, len(numbers) - k, 0, number) for k, number in enumerate(numbers)),
        (_RETURN, 0, 0, _REFUSE),
        (_RETURN, 0, 0, _ALLOW),
    ]
    return b"".join(struct.pack("=HBBI", *instruction) for instruction in instructions)


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


_libc = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG, _PR_SET_NO_NEW_PRIVS = 1, 38


def prctl(option: int, *arguments: object) -> int:
    """prctl(2). Raises OSError."""
    values = [*arguments, *([0] * (4 - len(arguments)))]
    return _checked(
        _libc.prctl(option, *(ctypes.c_ulong(value) if isinstance(value, int) else value for value in values))
    )


def syscall(number: int, *arguments: object) -> int:
    """syscall(2). Raises OSError."""
    values = (ctypes.c_long(value) if isinstance(value, int) else value for value in arguments)
    return _checked(_libc.syscall(ctypes.c_long(number), *values))


def forbid_new_privileges() -> None:
    """No program that this process starts can have more rights than it, by set-user-ID or otherwise. Raises OSError."""
    prctl(_PR_SET_NO_NEW_PRIVS, 1)


def die_with_parent() -> None:
    """The kernel kills this process when the thread of its parent that started it ends.

    This is kept across exec; a change of user or group takes it back. Raises OSError.
    """
    parent = os.getppid()
    prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # the parent ended before the call
        os.kill(os.getpid(), signal.SIGKILL)


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
