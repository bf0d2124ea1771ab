"""A time limit for bodies, so that no client holds connections for nothing; `api.protocol` has that of heads."""

import asyncio
import time

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.problems import http_problem

BODY_SECONDS = 30.0
"""Time that every body may take,"""
BODY_PACE = 2**16
"""and bytes per second at which a body must come that takes longer."""


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
