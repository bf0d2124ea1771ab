"""Middleware that protects the service from web sites that its users visit.

A web site can give its own name the address of this machine, and a browser then takes the service for a part of that
site (DNS rebinding); the name in the Host header shows it. A page of another site can make the browser of somebody who
is on this machine, or has a session here, send requests. A browser says where a request comes from (Fetch metadata,
Origin); other programs do not.
"""

import re
from collections.abc import Collection

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from api.problems import problem
from services.addresses import is_loopback

_HOST = re.compile(r"(?:\[([0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*)\]|([A-Za-z0-9._~-]+))(?::[0-9]{0,5})?")
"""An IPv6 address in brackets, or a name or IPv4 address, and perhaps a port."""


class KnownHosts:
    """Answers 400 for a Host that is none, and 421 for one that is neither loopback nor one of `hosts` (lower case)."""

    def __init__(self, app: ASGIApp, hosts: Collection[str]) -> None:
        self.app = app
        self.hosts = frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        host = Headers(scope=scope).get("host", "")
        name = _hostname(host)
        if host and not name:
            return await problem(400, f"{host[:100]!r} is no host")(scope, receive, send)
        if not is_loopback(name) and name not in self.hosts:
            detail = (
                f"this service does not answer for host {host[:100]!r}; SCENE_ATTACK_HOSTS lists those it answers for"
            )
            return await problem(421, detail)(scope, receive, send)
        return await self.app(scope, receive, send)


def _hostname(host: str) -> str:
    """The name or address in a Host header, in lower case; "" if it is none."""
    found = _HOST.fullmatch(host)
    return "" if found is None else (found[1] or found[2]).lower()


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
