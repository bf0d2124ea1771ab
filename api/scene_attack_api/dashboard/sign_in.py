"""The page on which a key is exchanged for a session, and the end of a session."""

import re
from typing import Annotated

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import RedirectResponse

from scene_attack_api.authentication import COOKIE, SIGN_IN
from scene_attack_api.dashboard.pages import HEADERS, html
from scene_attack_api.requests import KnownCaller, ServicesDependency
from scene_attack_service.access.caller import Caller, Scope
from scene_attack_service.access.keys import SESSION_SECONDS

_OWN_PAGE = re.compile(r"/(?:[A-Za-z0-9?][!-\[\]-~]*)?")
"""A path of this site. Browsers take //host and /\\host for other sites, also with blanks between."""

router = APIRouter(include_in_schema=False)


@router.get(SIGN_IN)
def page(caller: KnownCaller, next: Annotated[str, Query(max_length=500)] = "/") -> Response:  # noqa: A002 - in URLs
    """Asks for a key. Who needs none, or has a session, is sent on."""
    if caller is not None:
        return RedirectResponse(_own(next), 303, HEADERS)
    return html("sign_in.html", next=_own(next), wrong=None)


@router.post(SIGN_IN)
def sign_in(
    services: ServicesDependency,
    request: Request,
    key: Annotated[str, Form(max_length=200)] = "",
    next: Annotated[str, Form(max_length=500)] = "/",  # noqa: A002
) -> Response:
    """Begins a session with a key, in a cookie that scripts cannot read and other sites cannot make a browser send."""
    stored = services.keys.find(key.strip())
    if stored is None:
        return html("sign_in.html", 401, next=_own(next), wrong="No such key, or it is revoked or has expired.")
    services.keys.record_use(stored.prefix)
    caller = Caller.of(stored.owner, stored.scopes, stored.prefix)
    request.state.caller = caller  # for the audit log
    if not caller.may(Scope.JOBS_READ):
        wrong = f"This key has not the scope {Scope.JOBS_READ}, which the dashboard needs."
        return html("sign_in.html", 403, next=_own(next), wrong=wrong)
    answer = RedirectResponse(_own(next), 303, HEADERS)
    text, is_secure = services.sessions.begin(stored.prefix), request.url.scheme == "https"
    answer.set_cookie(COOKIE, text, SESSION_SECONDS, secure=is_secure, httponly=True, samesite="strict")
    return answer


@router.post("/sign-out")
def sign_out(services: ServicesDependency, request: Request) -> Response:
    """Ends the session, also for whoever else may have its cookie."""
    services.sessions.end(request.cookies.get(COOKIE, ""))
    answer = RedirectResponse(SIGN_IN, 303, HEADERS)
    answer.delete_cookie(COOKIE, secure=request.url.scheme == "https", httponly=True, samesite="strict")
    return answer


def _own(path: str) -> str:
    """The path if it leads to this site, else that of the first page."""
    return path if _OWN_PAGE.fullmatch(path) else "/"
