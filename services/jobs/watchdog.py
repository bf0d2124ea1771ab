"""Signs of life from a program to the one that keeps it running, in the protocol of systemd (sd_notify).

A program calls `alive()` from the loop whose standstill would be a fault, and says nothing where no one listens.
"""

import os
import socket
import time
from contextlib import suppress

SIGN_SECONDS = 1.0
"""Shortest time between two signs."""

_said = float("-inf")


def started() -> None:
    """Says that the program has started."""
    _notify("READY=1")


def alive() -> None:
    """Says that the program is alive; most calls within a second of the last one do nothing."""
    global _said
    now = time.monotonic()
    if now - _said >= SIGN_SECONDS:
        _said = now
        _notify("WATCHDOG=1")


def _notify(message: str) -> None:
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address:
        # A listener that does not listen must not stop the program.
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
            sender.sendto(message.encode(), "\0" + address[1:] if address.startswith("@") else address)


class Listener:
    """Hears a program's signs of life. Its `environ` tells the program where to send them."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind("")  # the kernel chooses an abstract name
        name = self._socket.getsockname()
        assert isinstance(name, bytes)
        self.environ = {"NOTIFY_SOCKET": "@" + name[1:].decode()}

    def heard(self) -> bool:
        """Whether there was a sign since the last call."""
        heard = False
        with suppress(BlockingIOError):
            while self._socket.recv(4096):
                heard = True
        return heard

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()
