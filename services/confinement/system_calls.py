"""Calls of the C library, and of the kernel where the C library has no function."""

import ctypes
import os
import signal

_libc = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG, _PR_SET_NO_NEW_PRIVS = 1, 38


def prctl(option: int, *arguments: object) -> int:
    """prctl(2). Raises OSError."""
    given = [*arguments, *([0] * (4 - len(arguments)))]
    return _checked(_libc.prctl(option, *(ctypes.c_ulong(one) if isinstance(one, int) else one for one in given)))


def syscall(number: int, *arguments: object) -> int:
    """syscall(2). Raises OSError."""
    given = (ctypes.c_long(one) if isinstance(one, int) else one for one in arguments)
    return _checked(_libc.syscall(ctypes.c_long(number), *given))


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
