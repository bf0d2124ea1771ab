"""Middleware that finds out who sends a request, and refuses it, before its body is read, if that caller may not.

While there is no key, the programs of this machine are let in and nobody else.
"""

import re
from typing import Annotated, Protocol
from urllib.parse import urlencode

from fastapi import Depends, Request
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.rules import OPEN, Rule, rule_of
from api.problems import problem
from api.reading import Reading
from services.access.caller import KEYLESS, Caller
from services.access.caller import Scope as AccessScope
from services.access.keys import AccessKeys, Sessions
from services.addresses import is_loopback
from services.logs import logger

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


class Doors(Protocol):
    """What this needs of the app's services."""

    keys: AccessKeys
    sessions: Sessions
    reading: Reading


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
            services: Doors = scope["app"].state.services
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


def _caller(services: Doors, scope: Scope) -> Caller | None:
    """Who sends a request, by its key or else by its session; None if it has neither and needs one."""
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


async def known_caller(request: Request) -> Caller | None:  # a function that is not async would be called in a thread
    """Who sends a request to an open route; None if nobody knows."""
    found = request.scope["state"]["caller"]
    assert found is None or isinstance(found, Caller)
    return found


KnownCaller = Annotated[Caller | None, Depends(known_caller)]


async def caller(request: Request) -> Caller:
    """Who sends a request to a route that needs a key."""
    found = await known_caller(request)
    assert found is not None
    return found


CallerDependency = Annotated[Caller, Depends(caller)]


def client_of(request: Request, caller: Caller) -> str:
    """Whose turn a request takes: that of its owner, or of its address if nobody has a key."""
    return f"owner {caller.owner}" if caller.key else "" if request.client is None else request.client.host


async def client(request: Request, caller: CallerDependency) -> str:
    """Whose turn a request takes, for routes."""
    return client_of(request, caller)


Client = Annotated[str, Depends(client)]
