"""Middleware that finds out who sends a request, and refuses it, before its body is read, if that caller may not.

`RULES` names the scope that each route needs. While there is no key, the programs of this machine are let in and nobody
else.
"""

import re
from dataclasses import dataclass
from re import Pattern
from urllib.parse import urlencode

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.routing import compile_path
from starlette.types import ASGIApp, Receive, Scope, Send

from api.problems import problem
from api.requests import Services
from services.access.caller import KEYLESS, Caller
from services.access.caller import Scope as AccessScope
from services.addresses import is_loopback
from services.logs import logger

OPEN = None
"""The rule of a route that needs no key."""

_READ, _WRITE, _UPLOAD = AccessScope.JOBS_READ, AccessScope.JOBS_WRITE, AccessScope.ASSETS_WRITE

PAGES = {
    "GET /docs": _READ,
    "GET /": _READ,
    "POST /jobs/selected": _WRITE,
    "GET /compare": _READ,
    "GET /compare/campaigns": _READ,
    "GET /jobs/{job_id}": _READ,
    "POST /jobs/{job_id}/cancel": _WRITE,
    "GET /new": _READ,
    "POST /new": _WRITE,
    "POST /jobs/{job_id}/about": _WRITE,
    "POST /jobs/{job_id}/retry": _WRITE,
    "POST /jobs/{job_id}/delete": _WRITE,
    "POST /jobs/{job_id}/continue": _WRITE,
    "GET /campaigns": _READ,
    "GET /campaigns/{campaign_id}": _READ,
    "POST /campaigns/{campaign_id}/{move}": _WRITE,
    "GET /assets": _READ,
    "POST /assets": _UPLOAD,
    "GET /assets/{asset:path}": _READ,
    "GET /targets": _READ,
}
"""The pages, as `RULES`. They send a browser without a session to sign in; the parts of pages answer 401 to the script
instead."""

RULES: dict[str, AccessScope | None] = {
    # Health, for load balancers; without a key it names no extension and no network
    "GET /healthz": OPEN,
    "GET /readyz": OPEN,
    "GET /metrics": AccessScope.METRICS_READ,
    # The API
    "POST /v1/jobs": _WRITE,
    "GET /v1/jobs": _READ,
    "GET /v1/jobs.csv": _READ,
    "GET /v1/jobs.json": _READ,
    "GET /v1/jobs/{job_id}": _READ,
    "PATCH /v1/jobs/{job_id}": _WRITE,
    "POST /v1/jobs/{job_id}/cancel": _WRITE,
    "POST /v1/jobs/{job_id}/retry": _WRITE,
    "POST /v1/jobs/{job_id}/continue": _WRITE,
    "DELETE /v1/jobs/{job_id}": _WRITE,
    "GET /v1/jobs/{job_id}/events": _READ,
    "GET /v1/jobs/{job_id}/artifacts": _READ,
    "GET /v1/jobs/{job_id}/artifacts/{name}": _READ,
    "POST /v1/preview": _WRITE,
    "GET /v1/jobs/{job_id}/export": _READ,
    "GET /v1/jobs/{job_id}/scene.glb": _READ,
    "POST /v1/campaigns": _WRITE,
    "GET /v1/campaigns": _READ,
    "GET /v1/campaigns/{campaign_id}": _READ,
    "POST /v1/campaigns/{campaign_id}/pause": _WRITE,
    "POST /v1/campaigns/{campaign_id}/resume": _WRITE,
    "POST /v1/campaigns/{campaign_id}/cancel": _WRITE,
    "GET /v1/campaigns/{campaign_id}/views": _READ,
    "GET /v1/campaigns/{campaign_id}/jobs": _READ,
    "GET /v1/campaigns/{campaign_id}/table.json": _READ,
    "GET /v1/campaigns/{campaign_id}/table.csv": _READ,
    "GET /v1/campaigns/{campaign_id}/table.tex": _READ,
    "GET /v1/campaigns/{campaign_id}/cases.csv": _READ,
    "POST /v1/rerenderings": _WRITE,
    "POST /v1/assets": _UPLOAD,
    "GET /v1/assets": _READ,
    "GET /v1/assets/{sha256}": _READ,
    "GET /v1/assets/{sha256}/thumbnail": _READ,
    "DELETE /v1/assets/{sha256}": _UPLOAD,
    "GET /v1/scenes": _READ,
    "GET /v1/targets": _READ,
    # Its description
    "GET /openapi.json": _READ,
    # The parts and files of pages
    "GET /parts/jobs": _READ,
    "GET /parts/jobs/changes": _READ,
    "GET /parts/jobs/{job_id}": _READ,
    "GET /new/choices.json": _READ,
    "GET /parts/campaigns": _READ,
    "GET /parts/campaigns/{campaign_id}": _READ,
    "GET /assets/pictures/{asset:path}": _READ,
    "GET /assets/scenes/{asset:path}": _READ,
    "GET /static/{path:path}": OPEN,
    "GET /sign-in": OPEN,
    "POST /sign-in": OPEN,
    "POST /sign-out": OPEN,
    **PAGES,
}
"""The method and path of each route, and its scope. A rule of GET is also that of HEAD."""


@dataclass(frozen=True)
class Rule:
    """The rule of a route: its method and path, and the scope it needs."""

    route: str
    scope: AccessScope | None

    @property
    def is_page(self) -> bool:
        """Whether a person sees the answer in a browser."""
        return self.route in PAGES


_COMPILED: list[tuple[str, Pattern[str], Rule]] = [
    (method, compile_path(path)[0], Rule(f"{method} {path}", scope))
    for route, scope in RULES.items()
    for method, path in [route.split(" ")]
]


def rule_of(method: str, path: str) -> Rule | None:
    """The rule of a request; None for a path that is not listed, or not with this method."""
    asked = "GET" if method == "HEAD" else method
    path = path.rstrip("/") or "/"  # the framework redirects a path with a slash at its end to the one without
    return next((rule for of, pattern, rule in _COMPILED if of == asked and pattern.match(path)), None)


_HTML = re.compile(r"(?:^|,)\s*text/html\s*(?:;(?!\s*q=0(?:\.0*)?\s*(?:,|$))[^,]*)?(?:,|$)", re.IGNORECASE)


def asks_for_html(scope: Scope) -> bool:
    """Whether the request's Accept header has HTML by its name, as a browser's has. A program that takes anything does
    not ask for it.
    """
    return _HTML.search(Headers(scope=scope).get("accept", "")) is not None


SIGN_IN = "/sign-in"
COOKIE = "scene-attack-session"
"""Name of the cookie with the text of a session of the dashboard."""
_HOW = {"WWW-Authenticate": "Bearer"}
log = logger(__name__)


class Authentication:
    """Answers 401 without a valid key, and 403 if its scopes do not allow the route; else it passes the caller on."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        rule = rule_of(scope["method"], scope["path"])
        is_open = rule is not None and rule.scope is OPEN
        refusal = None
        scope.setdefault("state", {})["caller"] = None
        try:
            services: Services = scope["app"].state.services
            caller = await services.reading(_caller, services, scope)
            scope["state"]["caller"] = caller
            if caller is not None and caller.key and services.keys.use_is_due(caller.key):
                await run_in_threadpool(services.keys.record_use, caller.key)  # a write, which may wait for others
            refusal = None if is_open else _refusal(rule, caller, scope)
        except SQLAlchemyError as error:
            if not is_open:
                log.warning("keys out of reach", error=str(error))
                refusal = problem(503, "the database does not answer; try again later", headers={"Retry-After": "5"})
        if refusal is not None:
            return await refusal(scope, receive, send)
        return await self.app(scope, receive, send)


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


def _refusal(rule: Rule | None, caller: Caller | None, asked: Scope) -> Response | None:
    if caller is None and rule is not None and rule.is_page and asks_for_html(asked):
        back = asked["path"] if asked["method"] in ("GET", "HEAD") else asked["path"].rpartition("/")[0]
        headers = {"Cache-Control": "no-store", "Vary": "Accept"}
        return RedirectResponse(f"{SIGN_IN}?{urlencode({'next': back})}", 303, headers)
    if caller is None:
        detail = "a key is needed that is known, not revoked and not expired; send it as `Authorization: Bearer KEY`"
        return problem(401, detail, headers=_HOW)
    scope = AccessScope.ADMIN if rule is None or rule.scope is None else rule.scope
    if caller.may(scope):
        return None
    if rule is None:
        return problem(404, "there is nothing here, or not by this method")
    how = {"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{scope}"'}
    return problem(403, f"this needs a key with the scope {scope}", headers=how)
