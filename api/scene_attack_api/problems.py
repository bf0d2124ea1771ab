"""Turns every error of the API into `application/problem+json` (RFC 9457)."""

import re
from collections.abc import Callable, Sequence
from http import HTTPStatus
from json import JSONDecodeError
from typing import Any, get_type_hints

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from pydantic.config import JsonDict
from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.responses import JSONResponse, Response
from starlette.routing import Match
from starlette.types import ASGIApp, Receive, Scope, Send

from scene_attack.client.schemas import BadField
from scene_attack.errors import InUse, InvalidRequest, QuotaExceeded, without_folders
from scene_attack.logs import logger
from scene_attack.runs.field_errors import in_words, invalid_fields
from scene_attack.runs.spec import JobSpec
from scene_attack.strict import Strict, json_mistake
from scene_attack_api.warm_pool import Unavailable
from scene_attack_service.jobs.database import outage_of
from scene_attack_service.jobs.files import Damaged
from scene_attack_service.jobs.jobs import KeyReused, QueueFull

MEDIA_TYPE = "application/problem+json"
REQUEST_ID = "X-Request-ID"
"""The header with the id of a request, which is in the lines of the log about it, too."""
MAX_DETAIL = 5000
"""Characters of the error in words, which repeats the first invalid fields."""
_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
log = logger(__name__)


_MISSPELT: JsonDict = {
    "type": "about:blank",
    "title": "Unprocessable Entity",
    "status": 422,
    "detail": "scene.objects.0.mesh: there is no mesh 'furniture/sofaa'; did you mean 'furniture/sofa' or "
    "'furniture/sofa3' or 'furniture/cap'?",
    "errors": [
        {
            "field": "scene.objects.0.mesh",
            "detail": "there is no mesh 'furniture/sofaa'; did you mean 'furniture/sofa' or 'furniture/sofa3' or "
            "'furniture/cap'?",
        }
    ],
}


class ProblemDetails(BaseModel):
    """An error (RFC 9457)."""

    model_config = ConfigDict(json_schema_extra={"examples": [_MISSPELT]})

    type: str = Field("about:blank", description="always about:blank: the status identifies the kind of problem")
    title: str = Field(description="the reason phrase of the HTTP status")
    status: int
    detail: str = Field(description="the error in words")
    errors: list[BadField] = Field([], description="the invalid fields, if the request has any")


_HTML = re.compile(r"(?:^|,)\s*text/html\s*(?:;(?!\s*q=0(?:\.0*)?\s*(?:,|$))[^,]*)?(?:,|$)", re.IGNORECASE)


def asks_for_html(scope: Scope) -> bool:
    """Whether the request's Accept header has HTML by its name, as a browser's has. A program that takes anything does
    not ask for it.
    """
    return _HTML.search(Headers(scope=scope).get("accept", "")) is not None


_OF_PROGRAMS = re.compile(r"/(?:v1|metrics|healthz|readyz|openapi\.json)(?:/|$)")
"""The beginning of paths that are no pages."""


class ProblemResponse(JSONResponse):
    """A problem document. A browser that asks for HTML gets a page that says the same, outside the API."""

    def __init__(self, document: ProblemDetails, headers: Any) -> None:
        super().__init__(document.model_dump(), document.status, headers, MEDIA_TYPE)
        self._document = document

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        answer: ASGIApp = super().__call__
        if not _OF_PROGRAMS.match(scope["path"]):
            self.headers.add_vary_header("Accept")
            answer = self._page(scope) if asks_for_html(scope) else answer
        await answer(scope, receive, send)

    def _page(self, scope: Scope) -> Response:
        """The page, with the headers that are not about its body."""
        about, caller = self._document, scope.get("state", {}).get("caller")
        page: Response = scope["app"].state.error_page(about.status, caller, title=about.title, detail=about.detail)
        for name, value in self.headers.items():
            if not name.startswith("content-"):
                page.headers.setdefault(name, value)
        return page


def problem(status: int, detail: str, errors: Sequence[InvalidRequest] = (), headers: Any = None) -> Response:
    """A response with a problem document; `errors` are its invalid fields, `headers` are added to the response."""
    body = ProblemDetails(
        title=HTTPStatus(status).phrase,
        status=status,
        detail=without_folders(detail)[:MAX_DETAIL],
        errors=[BadField(field=error.field, detail=without_folders(error.detail)) for error in errors],
    )
    return ProblemResponse(body, headers)


def invalid(errors: Sequence[InvalidRequest]) -> Response:
    """A 422 response for these invalid fields."""
    return problem(422, "; ".join(str(error) for error in errors[:3]), errors)


class BadRequestField(HTTPException):
    """An InvalidRequest raised while the body is being read, where the framework passes on only HTTPException."""

    def __init__(self, error: InvalidRequest) -> None:
        super().__init__(422, str(error))
        self.errors = [error]


def http_problem(error: HTTPException) -> Response:
    """A framework error as a problem document with the same status and headers."""
    if error.status_code < 400:
        return Response(status_code=error.status_code, headers=error.headers)
    errors = error.errors if isinstance(error, BadRequestField) else ()
    return problem(error.status_code, str(error.detail), errors, error.headers)


_LATER = {"Retry-After": "5"}
_REUSED = InvalidRequest("Idempotency-Key", "this key was used for a different request; take a new one")
_ANSWERS: dict[type[Exception], Callable[[Any], Response]] = {
    InvalidRequest: lambda error: invalid(error.every),
    QueueFull: lambda _: problem(503, "as many jobs are queued as this service takes; try again later", headers=_LATER),
    QuotaExceeded: lambda error: problem(429, str(error), headers={"Retry-After": f"{error.seconds:.0f}"}),
    InUse: lambda error: problem(409, str(error)),
    KeyReused: lambda _: invalid([_REUSED]),
    Unavailable: lambda error: problem(503, str(error), headers=_LATER),
}
"""The answer to each error that tells a client what to do."""


def install(app: FastAPI, error_page: Callable[..., Response]) -> None:
    """Installs handlers on the app that answer every error by a problem document, or by a page made of its status, the
    caller, its title and its detail.
    """
    app.state.error_page = error_page

    for kind, answer in _ANSWERS.items():
        app.add_exception_handler(kind, lambda _, error, answer=answer: answer(error))

    @app.exception_handler(RequestValidationError)
    def _unparsed(request: Request, error: RequestValidationError) -> Response:
        items = error.errors()
        if isinstance(error.__cause__, JSONDecodeError):
            return _unreadable(error.__cause__)
        # pydantic's paths begin with "body", "query" or "header"; clients know fields without that part.
        items = [_without_file(item) for item in items]
        asked = [item for item in items if item["loc"][:1] != ("body",)]
        sent = [item | {"loc": item["loc"][1:]} for item in items if item["loc"][:1] == ("body",)]
        # One of several values of a parameter is called by the parameter's name, as it was sent.
        parameters = [InvalidRequest(str(item["loc"][1]), in_words(item)) for item in asked]
        return invalid([*parameters, *_fields_of(request)(sent)])

    @app.exception_handler(HTTPException)
    def _http(request: Request, error: HTTPException) -> Response:
        if error.status_code == 405:  # the framework names the methods of the first route of the path only
            error.headers = {"Allow": ", ".join(_allowed(app, request.url.path))}
        # What was wrong with a body that the framework could not parse.
        if error.status_code == 400 and isinstance(error.__cause__, ValueError | RecursionError):
            return _unreadable(error.__cause__)
        if isinstance(error.__context__, MultiPartException):
            return problem(400, f"the body cannot be read as a form: {error.detail}")
        return http_problem(error)

    @app.exception_handler(SQLAlchemyError)
    @app.exception_handler(RedisError)
    @app.exception_handler(OSError)
    def _away(request: Request, error: Exception) -> Response:
        outage = outage_of(error)
        if outage is None:
            return _unexpected(request, error)
        log.warning("request met an outage", resource=outage.resource, error=str(error))
        return problem(503, f"{outage.detail}; try again later", headers=_LATER)

    @app.exception_handler(Damaged)
    def _damaged(_: Request, error: Damaged) -> Response:
        log.error("artifact damaged", error=str(error))
        return problem(500, str(error))

    @app.exception_handler(Exception)
    def _unexpected(request: Request, error: Exception) -> Response:
        log.error("request failed", method=request.method, path=request.url.path, exc_info=error)
        # The server closes the connection after this, so a client must not send its next request on it.
        headers = {"Connection": "close", REQUEST_ID: request.scope.get("request_id", "")}
        return problem(500, "the service made a mistake; its log says which", headers=headers)


def _unreadable(error: Exception) -> Response:
    detail = json_mistake(error)
    # A body that is JSON, but not one that is read, is answered as any other request that is refused.
    if isinstance(error, JSONDecodeError | UnicodeDecodeError):
        return problem(400, f"the body cannot be read: {detail}")
    return invalid([InvalidRequest("body", detail)])


def _without_file(item: dict[str, Any]) -> dict[str, Any]:
    """An invalid field of a form; a file in the place of a text is called a file."""
    return item | {"input": "a file"} if isinstance(item.get("input"), UploadFile) else item


def _fields_of(request: Request) -> Callable[[list[dict[str, Any]]], list[InvalidRequest]]:
    """The function that names the invalid fields of a request, by the model of its body."""
    hints = get_type_hints(request.scope["endpoint"]).values()
    models = [hint for hint in hints if isinstance(hint, type) and issubclass(hint, Strict)]
    model = models[0] if models else JobSpec
    return lambda items: invalid_fields(items, model)


def _allowed(app: FastAPI, path: str) -> list[str]:
    """The methods of all routes of a path."""
    asked = {"type": "http", "path": path, "root_path": "", "headers": []}
    return [
        method
        for method in _METHODS
        if any(route.matches(asked | {"method": method})[0] is Match.FULL for route in app.router.routes)
    ]
