"""Middleware that limits how many uploads a client has open, before any of their bytes is read.

The bytes of an upload that is read or waits are in a temporary file, which in a container may be memory.
"""

from collections import Counter
from collections.abc import Collection

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.authentication import client_of
from api.problems import problem
from services.access.caller import Caller

MOST = 8
"""Uploads of one client at the same time; two of all clients are parsed at once."""
RETRY_SECONDS = 5


class OpenUploads:
    """Answers 429 to an upload to one of `paths` of a client that has `most` open on all of them: the same owner, or
    address without keys.
    """

    def __init__(self, app: ASGIApp, paths: Collection[str], most: int = MOST) -> None:
        self.app = app
        self.paths = paths
        self.most = most
        self._open: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http" or scope["method"] != "POST" or scope["path"] not in self.paths:
            return await self.app(scope, receive, send)
        caller = scope["state"]["caller"]
        assert isinstance(caller, Caller)  # the route needs a key, or there is none
        client = client_of(Request(scope), caller)
        if self._open[client] >= self.most:
            detail = f"{self.most} uploads of yours are open already; send the next when one has been answered"
            return await problem(429, detail, headers={"Retry-After": str(RETRY_SECONDS)})(scope, receive, send)
        self._open[client] += 1
        is_open = True

        def close() -> None:
            nonlocal is_open
            if is_open:
                is_open = False
                self._open[client] -= 1
                if not self._open[client]:
                    del self._open[client]

        async def answered(message: Message) -> None:
            if message["type"] == "http.response.start":  # whoever has the answer may send the next one
                close()
            await send(message)

        try:
            return await self.app(scope, receive, answered)
        finally:
            close()
