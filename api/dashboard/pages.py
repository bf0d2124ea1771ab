"""Renders the dashboard's pages from its templates, with headers that let them load nothing from other sites.

A person is shown the errors of pages as pages; programs get the problem document.
"""

import json
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from hashlib import sha256
from http import HTTPStatus
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.authentication import asks_for_html
from api.dashboard import words
from api.dashboard.charts import polar
from api.problems import MEDIA_TYPE
from services.access.caller import Caller
from services.jobs.models import CampaignState, State
from services.pipeline.names import group_words
from services.pipeline.question_record import CHANGED
from services.text import signed

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; img-src 'self'; style-src 'self'; script-src 'self'; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def _static(folder: Traversable, before: str = "") -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _static(entry, f"{before}{entry.name}/")
        else:
            yield before + entry.name, entry.read_bytes()


AREAS = (
    ("jobs", "/", "Jobs"),
    ("new", "/new", "New job"),
    ("campaigns", "/campaigns", "Campaigns"),
    ("assets", "/assets", "Assets"),
    ("targets", "/targets", "Targets"),
    ("reference", "/docs", "API reference"),
)
"""The areas of the dashboard: name, address and title. A template sets `area` to the name of its own."""


STATIC = dict(_static(files(__package__).joinpath("static")))
"""The style sheets, scripts and images of pages, by path."""
VERSION = sha256(b"".join(name.encode() + STATIC[name] for name in sorted(STATIC))).hexdigest()[:12]


def static(name: str) -> str:
    """The address of a file of `STATIC`. It contains the version as a folder, so that what a module imports by a
    relative address has it too. Raises KeyError if there is no such file.
    """
    STATIC[name]
    return f"/static/{VERSION}/{name}"


def prose(text: str) -> Markup:
    """Text of the API's description as HTML: what stands between backticks is code."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if k % 2 else escape(part) for k, part in enumerate(parts)
    )


_templates = Environment(
    loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
)
_templates.globals |= {
    "version": VERSION,
    "static": static,
    "words": words,
    "group_words": group_words,
    "signed": signed,
    "states": list(State),
}
_templates.globals["areas"] = AREAS
_templates.filters["prose"] = prose
_templates.globals |= {"campaign_states": list(CampaignState), "changed": CHANGED, "polar": polar}


def html(template: str, status: int = 200, caller: Caller | None = None, **values: Any) -> Response:
    """A page made of a template and values, for a caller who can sign out if it has a key."""
    text = _templates.get_template(template).render(now=datetime.now(UTC), caller=caller, **values)
    return HTMLResponse(text, status, HEADERS)


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
