"""Middleware that gives each request an id, and logs who changed what and who was refused.

An id is in the lines of the log about its request, and in its answer.
"""

import re
from uuid import uuid4

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.rules import rule_of
from api.problems import REQUEST_ID
from services.access.caller import Caller
from services.logs import logger

_SANE = re.compile(r"[A-Za-z0-9._:-]{1,128}")


class RequestId:
    """Takes the id from the client or from a proxy if it is plain text, and makes one otherwise."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        given = Headers(scope=scope).get(REQUEST_ID, "")
        request_id = scope["request_id"] = given if _SANE.fullmatch(given) else uuid4().hex
        # The server runs each request in a task of its own, so this ends with the request.
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request=request_id)

        async def named(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(raw=message["headers"])[REQUEST_ID] = request_id
            await send(message)

        return await self.app(scope, receive, named)


REFUSED = (400, 401, 403, 421, 429)
READS = ("GET", "HEAD", "OPTIONS")
LONGEST = 200
"""Characters of a path that a line has."""

log = logger("audit")


class Audit:
    """Logs every request that is no mere reading, and every one that is refused at the door.

    The line has the prefix of the key, its owner, the client's address, the route, the object (the path, or the place
    of what was made) and the status; as every line about a request it has its id. Bodies, queries and keys are not in
    it.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)

        async def audited(message: Message) -> None:
            if message["type"] == "http.response.start":
                _record(scope, message)
            await send(message)

        return await self.app(scope, receive, audited)


def _record(scope: Scope, answer: Message) -> None:
    status = answer["status"]
    if scope["method"] in READS and status not in REFUSED:
        return
    caller = scope.get("state", {}).get("caller")
    who = {"key": caller.key, "owner": caller.owner} if isinstance(caller, Caller) else {"key": None, "owner": None}
    rule = rule_of(scope["method"], scope["path"])
    made = Headers(raw=answer["headers"]).get("location", "") if status in (201, 202) else ""
    log.info(
        "audit",
        **who,
        client=scope["client"][0] if scope["client"] else None,
        route=f"{scope['method'][:20]} -" if rule is None else rule.route,
        object=(made or scope["path"])[:LONGEST],
        status=status,
    )
