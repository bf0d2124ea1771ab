"""Time limits for requests that come slowly, so that no client holds connections for nothing.

The server, uvicorn, waits for ever for the head of a request; `HeadLimit` is its protocol with a limit. The body is
limited by `BodyPace`.
"""

import asyncio
import time
from typing import Any

import h11
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from api.problems import http_problem
from api.small_chunks import CountedChunks

HEAD_SECONDS = 15.0
"""Longest time from a connection, or from the first byte of a later request on it, to the end of the request's head."""
BODY_SECONDS = 30.0
"""Time that every body may take,"""
BODY_PACE = 2**16
"""and bytes per second at which a body must come that takes longer."""
_TOO_SLOW = b"HTTP/1.1 408 Request Timeout\r\nconnection: close\r\ncontent-length: 0\r\n\r\n"


class HeadLimit(H11Protocol):
    """HTTP/1.1 in which the head of a request has to come in time, and a body in no more chunks than `CountedChunks`
    takes. Between requests, uvicorn's own limit holds.
    """

    head_seconds = HEAD_SECONDS
    _head: asyncio.TimerHandle | None = None

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.conn = CountedChunks(h11.SERVER)

    def send_400_response(self, msg: str) -> None:
        """Answers what is no HTTP, unless an answer has begun already; then the connection is closed."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.transport.close()

    def connection_made(self, transport: Any) -> None:
        """Expects a first request."""
        super().connection_made(transport)
        self._expect()

    def data_received(self, data: bytes) -> None:
        """Expects the rest of the head, if this was not its end."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._forget()
        elif self._head is None:
            self._expect()

    def connection_lost(self, exc: Exception | None) -> None:
        """Expects nothing."""
        self._forget()
        super().connection_lost(exc)

    def _expect(self) -> None:
        self._head = self.loop.call_later(self.head_seconds, self._give_up)

    def _forget(self) -> None:
        if self._head is not None:
            self._head.cancel()
            self._head = None

    def _give_up(self) -> None:
        if not self.transport.is_closing() and self.conn.their_state is h11.IDLE:
            self.transport.write(_TOO_SLOW)
            self.transport.close()


class BodyPace:
    """Answers 408 where a body takes longer than `seconds` and comes at less than `BODY_PACE`."""

    def __init__(self, app: ASGIApp, seconds: float = BODY_SECONDS) -> None:
        self.app = app
        self.seconds = seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        deadline = time.monotonic() + self.seconds
        complete = False

        async def in_time() -> Message:
            nonlocal deadline, complete
            if complete:  # what follows is the end of the connection
                return await receive()
            try:
                async with asyncio.timeout(max(deadline - time.monotonic(), 0)):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, "the body came too slowly", {"Connection": "close"}) from None
            deadline += len(message.get("body", b"")) / BODY_PACE
            complete = not message.get("more_body", False)
            return message

        try:
            return await self.app(scope, in_time, send)
        except HTTPException as error:  # raised where no route had taken the request yet
            return await http_problem(error)(scope, receive, send)
