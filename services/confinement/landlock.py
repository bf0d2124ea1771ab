"""Takes the file system from a process, and TCP where the kernel can (Landlock, Linux 5.13 and later)."""

import ctypes
import os
import struct

from services.confinement.system_calls import forbid_new_privileges, syscall

_CREATE_RULESET, _RESTRICT_SELF = 444, 446
_GET_VERSION = 1
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
"""Number of rights over files that each version knows: they are the lowest bits of a mask."""


def forbid_files() -> None:
    """Refuses this thread, for ever, to open, list, make, move or remove any file, and to use TCP.

    What is open stays open. Raises OSError if the kernel has no Landlock.
    """
    version = syscall(_CREATE_RULESET, 0, 0, _GET_VERSION)
    files = (1 << _FILE_RIGHTS[min(version, max(_FILE_RIGHTS))]) - 1
    tcp = 0b11 if version >= 4 else 0  # to bind, to connect
    rights = struct.pack("=QQ", files, tcp) if version >= 4 else struct.pack("=Q", files)
    forbid_new_privileges()
    ruleset = syscall(_CREATE_RULESET, ctypes.c_char_p(rights), len(rights), 0)
    try:
        syscall(_RESTRICT_SELF, ruleset, 0)  # a right that is named, and given by no rule, is refused
    finally:
        os.close(ruleset)
