"""Middleware that logs who changed what, and who was refused: one line for each such request."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.auth_rules import rule_of
from services.access.caller import Caller
from services.logs import logger

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
