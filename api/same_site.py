"""Middleware that refuses what another web site makes a browser send.

The user's browser is on this machine, or has a session here; a page of another site that it visits must not be able to
use either. A browser says where a request comes from (Fetch metadata, Origin); other programs do not.
"""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from api.problems import problem

_OWN = ("same-origin", "none")
"""Values of Sec-Fetch-Site: this service's own pages, and what the user typed. `same-site` is another port."""


class SameSite:
    """Answers 403 to other sites' requests, but for a link to a page that the user follows."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] == "http" and _is_foreign(scope["method"], Headers(scope=scope)):
            return await problem(403, "requests from other web sites are refused")(scope, receive, send)
        return await self.app(scope, receive, send)


def _is_foreign(method: str, headers: Headers) -> bool:
    reads = method in ("GET", "HEAD")
    origin = headers.get("origin")
    if origin is not None and not reads and origin.partition("://")[2] != headers.get("host"):
        return True
    if headers.get("sec-fetch-site", "none") in _OWN:
        return False
    link = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest", "document") == "document"
    return not (reads and link)
