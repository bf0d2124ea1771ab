"""Sends a message to a webhook as Standard Webhooks says (https://www.standardwebhooks.com), and nowhere else.

The address that a name resolves to is checked, and that very address is connected to: another look-up could give
another one. Redirects are not followed, and of the answer only its status is read.
"""

import hmac
import ssl
import time
from base64 import b64decode, b64encode
from collections.abc import Iterable
from hashlib import sha256
from socket import SOCK_STREAM, getaddrinfo
from typing import Any
from urllib.parse import urlsplit

import httpcore

from services.addresses import is_public, read
from services.errors import InvalidRequest
from services.jobs.webhooks import Message

SECONDS = 15.0
"""Longest time of an attempt, from the look-up of the name to the status of the answer."""
LONGEST_URL = 2000


class Refused(Exception):
    """An address that nothing is sent to."""


def check_url(url: str, allowed: frozenset[str]) -> None:
    """Raises InvalidRequest("url") unless it is an https URL, or one of an allowed host, without a user or fragment."""
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname or "", parts.port
    except ValueError as error:
        raise InvalidRequest("url", f"it is no URL: {error}") from error
    if len(url) > LONGEST_URL or not url.isascii() or not url.isprintable() or " " in url:
        raise InvalidRequest("url", f"at most {LONGEST_URL} printable ASCII characters")
    if not host or parts.username is not None or parts.password is not None or parts.fragment:
        raise InvalidRequest("url", "a host, and no user name, password or fragment")
    if parts.scheme != "https" and not (parts.scheme == "http" and host in allowed):
        raise InvalidRequest("url", "it has to begin with https://")
    try:
        address = read(host)
    except ValueError:
        return
    if host not in allowed and not is_public(address):
        raise InvalidRequest("url", "the address is not public; the operator allows such by SCENE_ATTACK_WEBHOOK_HOSTS")


def headers(message: Message, timestamp: int) -> dict[str, str]:
    """The headers of a message, with its signature."""
    key = b64decode(message.secret.removeprefix("whsec_"))
    signed = f"{message.id}.{timestamp}.".encode() + message.body
    signature = b64encode(hmac.digest(key, signed, sha256)).decode()
    return {
        "content-type": "application/json",
        "user-agent": "scene-attack",
        "webhook-id": message.id,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": f"v1,{signature}",
    }


def send(message: Message, allowed: frozenset[str], seconds: float = SECONDS) -> tuple[int | None, str | None]:
    """Sends a message. Returns the status of the answer, if there was one, and what was wrong, if anything was."""
    given = [(b"host", urlsplit(message.url).netloc.encode())]
    given += [(name.encode(), text.encode()) for name, text in headers(message, int(time.time())).items()]
    given.append((b"content-length", str(len(message.body)).encode()))
    backend = _Checked(allowed, time.monotonic() + seconds)
    extensions = {"timeout": dict.fromkeys(("connect", "read", "write", "pool"), seconds)}
    try:
        with (
            httpcore.ConnectionPool(ssl.create_default_context(), network_backend=backend) as pool,
            pool.stream("POST", message.url, headers=given, content=message.body, extensions=extensions) as said,
        ):
            status = said.status
    except (Refused, OSError, httpcore.NetworkError, httpcore.TimeoutException, httpcore.ProtocolError) as error:
        return None, f"{type(error).__name__}: {error}"
    except (ValueError, httpcore.UnsupportedProtocol) as error:
        return None, f"the URL cannot be used: {error}"
    return status, None if 200 <= status < 300 else f"it answered {status}"


class _Checked(httpcore.NetworkBackend):
    """Connects to public addresses and allowed hosts; everything has to be over at `deadline`."""

    def __init__(self, allowed: frozenset[str], deadline: float) -> None:
        self._allowed = allowed
        self._deadline = deadline
        self._plain = httpcore.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.NetworkStream:
        """Resolves the name once, and connects to an address of it that may be connected to."""
        for *_, place in getaddrinfo(host, port, type=SOCK_STREAM):
            text = str(place[0])
            if host in self._allowed or text in self._allowed or is_public(read(text)):
                left = _left(self._deadline, timeout)
                return _Timed(self._plain.connect_tcp(text, port, left, local_address, socket_options), self._deadline)
        raise Refused(f"{host} has no public address; the operator allows others by SCENE_ATTACK_WEBHOOK_HOSTS")


class _Timed(httpcore.NetworkStream):
    """A connection whose reads and writes together end at a deadline, however slowly the other side answers."""

    def __init__(self, stream: httpcore.NetworkStream, deadline: float) -> None:
        self._stream = stream
        self._deadline = deadline

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        """Reads for as long as there is time."""
        return self._stream.read(max_bytes, _left(self._deadline, timeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        """Writes for as long as there is time."""
        self._stream.write(buffer, _left(self._deadline, timeout))

    def close(self) -> None:
        """Closes the connection."""
        self._stream.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        """Goes on encrypted; the certificate has to be the name's, not the address's."""
        made = self._stream.start_tls(ssl_context, server_hostname, _left(self._deadline, timeout))
        return _Timed(made, self._deadline)

    def get_extra_info(self, info: str) -> Any:
        """What the connection knows of itself."""
        return self._stream.get_extra_info(info)


def _left(deadline: float, timeout: float | None) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise httpcore.TimeoutException("the answer took too long")
    return left if timeout is None else min(left, timeout)
