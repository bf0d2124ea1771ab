"""Middleware that finds out who sends a request, and refuses it, before its body is read, if that caller may not.

`scope_of` names the scope that a request needs. While there is no key, the programs of this machine are let in and
nobody else.
"""

import re
from urllib.parse import urlencode

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.types import Receive, Scope, Send

from scene_attack.addresses import is_loopback
from scene_attack.logs import logger
from scene_attack_api.asgi import HttpMiddleware
from scene_attack_api.problems import asks_for_html, problem
from scene_attack_api.requests import Services
from scene_attack_service.access.caller import KEYLESS, Caller
from scene_attack_service.access.caller import Scope as AccessScope

_OPEN = re.compile(r"/(?:healthz|readyz|sign-in|sign-out|static/.*)")
"""The paths that need no key: health, for load balancers, which without a key names no plug-in and no network; and
the way to a session."""
_FOR_SCRIPTS = re.compile(r"/(?:v1|parts|metrics|openapi\.json)(?:/|$)")
"""The beginning of paths that are no pages: a browser without a session gets 401 there, and is not sent to sign in."""


def scope_of(method: str, path: str) -> AccessScope | None:
    """The scope that a request needs; None if it needs no key. Reading needs less than changing."""
    path = path.rstrip("/")  # the framework redirects a path with a slash at its end to the one without
    if _OPEN.fullmatch(path):
        return None
    if method in ("GET", "HEAD", "OPTIONS"):
        return AccessScope.METRICS_READ if path == "/metrics" else AccessScope.JOBS_READ
    is_upload = re.match(r"(?:/v1)?/assets(?:/|$)", path) is not None
    return AccessScope.ASSETS_WRITE if is_upload else AccessScope.JOBS_WRITE


SIGN_IN = "/sign-in"
COOKIE = "scene-attack-session"
"""Name of the cookie with the text of a session of the dashboard."""
_HOW = {"WWW-Authenticate": "Bearer"}
log = logger(__name__)


class Authentication(HttpMiddleware):
    """Answers 401 without a valid key, and 403 if its scopes do not allow the route; else it passes the caller on."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers what is refused."""
        needed = scope_of(scope["method"], scope["path"])
        refusal = None
        scope.setdefault("state", {})["caller"] = None
        try:
            services: Services = scope["app"].state.services
            caller = await run_in_threadpool(_caller, services, scope)
            scope["state"]["caller"] = caller
            if caller is not None and caller.key and services.keys.use_is_due(caller.key):
                await run_in_threadpool(services.keys.record_use, caller.key)  # a write, which may wait for others
            refusal = None if needed is None else _refusal(needed, caller, scope)
        except SQLAlchemyError as error:
            if needed is not None:
                log.warning("keys out of reach", error=str(error))
                refusal = problem(503, "the database does not answer; try again later", headers={"Retry-After": "5"})
        await (refusal or self.app)(scope, receive, send)


def _caller(services: Services, scope: Scope) -> Caller | None:
    """Returns the sender of a request, by its key or else by its session; None if it has neither and needs one."""
    key, headers = None, Headers(scope=scope)
    word, _, text = headers.get("authorization", "").partition(" ")
    if word.lower() == "bearer":
        key = services.keys.find(text.strip())
    elif not word:
        prefix = services.sessions.key_of(cookie_parser(headers.get("cookie", "")).get(COOKIE, ""))
        key = None if prefix is None else services.keys.of_prefix(prefix)
    if key is not None:
        return Caller.of(key.owner, key.scopes, key.prefix)
    here = scope["client"] is not None and is_loopback(scope["client"][0])
    return KEYLESS if here and not services.keys.exist() else None


def _refusal(needed: AccessScope, caller: Caller | None, asked: Scope) -> Response | None:
    if caller is None and asks_for_html(asked) and not _FOR_SCRIPTS.match(asked["path"]):
        back = asked["path"] if asked["method"] in ("GET", "HEAD") else asked["path"].rpartition("/")[0]
        headers = {"Cache-Control": "no-store", "Vary": "Accept"}
        return RedirectResponse(f"{SIGN_IN}?{urlencode({'next': back})}", 303, headers)
    if caller is None:
        detail = "a key is needed that is known, not revoked and not expired; send it as `Authorization: Bearer KEY`"
        return problem(401, detail, headers=_HOW)
    if caller.may(needed):
        return None
    how = {"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{needed}"'}
    return problem(403, f"this needs a key with the scope {needed}", headers=how)
