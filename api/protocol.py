"""HTTP/1.1 with the limits that the server, uvicorn, does not have: of a head's time and size, and of small chunks.

A byte that comes as a chunk of its own takes six on the wire, and calls of the parser's: a body of many keeps all
other requests waiting, within every limit of size and time.
"""

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEAD_SECONDS = 15.0
"""Longest time from a connection, or from the first byte of a later request on it, to the end of the request's head.

Likewise from an answer to the end of the body that it did not wait for.
"""
HEAD_BYTES = 2**16
"""Bytes of the largest head, and of whatever else the parser keeps before it says anything of it."""
MOST_CHUNKS = 1000
"""Chunks that every body may have,"""
LEAST_BYTES = 512
"""and bytes per chunk, on average, of a body that has more."""
_TOO_SLOW = b"HTTP/1.1 408 Request Timeout\r\nconnection: close\r\ncontent-length: 0\r\n\r\n"


class BadHead(Exception):
    """The head or the body of a request is not what this server takes. The parser answers 400 for it."""


class LimitedHttp(HttpToolsProtocol):
    """HTTP/1.1 in which a head has to come in time and in `HEAD_BYTES`, and a body in no more chunks than are allowed.

    Between requests, uvicorn's own limit holds.
    """

    head_seconds = HEAD_SECONDS
    _waiting: asyncio.TimerHandle | None = None
    _in_head = False
    _head_bytes = 0
    _silent_bytes = 0
    """Bytes since the parser last called this object: those that it keeps."""
    _chunks = 0
    _body_bytes = 0

    def connection_made(self, transport: Any) -> None:
        """Expects a first request."""
        super().connection_made(transport)
        self._expect()

    def connection_lost(self, exc: Exception | None) -> None:
        """Expects nothing."""
        self._forget()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Feeds the parser, which calls the functions below."""
        self._silent_bytes += len(data)
        super().data_received(data)
        if self._silent_bytes > HEAD_BYTES and not self.transport.is_closing():
            self.send_400_response("The head is too large.")
        elif self._in_head and self._waiting is None:
            self._expect()

    def send_400_response(self, msg: str) -> None:
        """Answers what is no HTTP, unless an answer has begun already; then the connection is closed."""
        if self.cycle is None or self.cycle.response_complete or not self.cycle.response_started:
            super().send_400_response(msg)
        else:
            self.transport.close()

    def on_message_begin(self) -> None:
        """A request begins."""
        super().on_message_begin()
        self._in_head = True
        self._head_bytes = self._chunks = self._body_bytes = 0

    def on_url(self, url: bytes) -> None:
        """A part of the address. Raises BadHead for more than `HEAD_BYTES`."""
        self._count(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """A header. Those after a body, which come when the request has been taken, are left out. Raises BadHead."""
        self._count(len(name) + len(value) + 4)
        if self._in_head:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """The head has ended. Raises BadHead unless it names a path of this server and one host, as HTTP/1.1 has it."""
        self._silent_bytes = 0
        self._in_head = False
        self._forget()
        hosts = sum(name == b"host" for name, _ in self.headers)
        version = self.parser.get_http_version()
        if hosts > 1 or (hosts == 0 and version == "1.1"):
            raise BadHead("a request names one host")
        if version not in ("1.0", "1.1") or not self.url.startswith((b"/", b"*")):
            raise BadHead("a request names a path, and its version is 1.0 or 1.1")
        super().on_headers_complete()

    def on_chunk_header(self) -> None:
        """A chunk begins."""
        self._chunks += 1

    def on_body(self, body: bytes) -> None:
        """A part of the body. Raises BadHead where the chunks are too small."""
        self._silent_bytes = 0
        self._body_bytes += len(body)
        if self._chunks > MOST_CHUNKS + self._body_bytes // LEAST_BYTES:
            raise BadHead("the body has too many small chunks")
        super().on_body(body)

    def on_message_complete(self) -> None:
        """The request has ended."""
        self._silent_bytes = 0
        self._forget()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """The answer has been sent. What is left of the body has to come in time, too."""
        super().on_response_complete()
        unread = self.cycle.response_complete and self.cycle.more_body
        if unread and self._waiting is None:
            self._expect()

    def _count(self, size: int) -> None:
        self._silent_bytes = 0
        self._head_bytes += size
        if self._head_bytes > HEAD_BYTES:
            raise BadHead("the head is too large")

    def _expect(self) -> None:
        self._waiting = self.loop.call_later(self.head_seconds, self._give_up)

    def _forget(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _give_up(self) -> None:
        if self.transport.is_closing():
            return
        if self.cycle is None or (self._in_head and self.cycle.response_complete):
            self.transport.write(_TOO_SLOW)
        self.transport.close()
