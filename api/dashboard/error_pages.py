"""Middleware that shows a person the errors of pages as pages. Programs get the problem document."""

import json
import re
from http import HTTPStatus

from fastapi import FastAPI, Request
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.authentication import asks_for_html
from api.dashboard.pages import html
from api.problems import MEDIA_TYPE

_OF_PROGRAMS = re.compile(r"/(?:v1|metrics|healthz|readyz|openapi\.json)(?:/|$)")
"""The beginning of paths that are no pages."""


class ErrorPages:
    """Turns problem documents into pages, for a browser that asks for HTML and outside the API."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http" or _OF_PROGRAMS.match(scope["path"]):
            return await self.app(scope, receive, send)
        is_browser = _is_for_a_person(scope)
        start: Message | None = None
        document = b""

        async def turned(message: Message) -> None:
            nonlocal start, document
            if message["type"] == "http.response.start" and _is_problem(message):
                MutableHeaders(raw=message["headers"]).add_vary_header("Accept")
                if is_browser:
                    start = message
                    return
            if start is None:
                await send(message)
                return
            document += message.get("body", b"")
            if not message.get("more_body", False):
                begun, start = start, None
                await _page(scope, begun["status"], begun["headers"], document)(scope, receive, send)

        return await self.app(scope, receive, turned)


def show_mistakes(app: FastAPI) -> None:
    """Shows a person the page of an exception that nothing caught. The framework answers it outside of all middleware,
    by the handler that is installed for it."""
    document = app.exception_handlers[Exception]

    def shown(request: Request, error: Exception) -> Response:
        answer = document(request, error)
        assert isinstance(answer, Response)
        if not _is_for_a_person(request.scope):
            return answer
        return _page(request.scope, answer.status_code, answer.raw_headers, bytes(answer.body))

    app.add_exception_handler(Exception, shown)


def _is_for_a_person(scope: Scope) -> bool:
    return not _OF_PROGRAMS.match(scope["path"]) and asks_for_html(scope)


def _is_problem(message: Message) -> bool:
    return Headers(raw=message["headers"]).get("content-type", "").startswith(MEDIA_TYPE)


def _page(scope: Scope, status: int, headers: list[tuple[bytes, bytes]], document: bytes) -> Response:
    """The page of a problem, with the problem's status and the headers that are not about its body."""
    detail = json.loads(document)["detail"] if document else ""
    page = html(
        "error.html", status, scope.get("state", {}).get("caller"), title=HTTPStatus(status).phrase, detail=detail
    )
    for name, value in Headers(raw=headers).items():
        if not name.startswith("content-"):
            page.headers.setdefault(name, value)
    return page
