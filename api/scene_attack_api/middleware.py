"""Middleware that each request passes before it is parsed, from the outermost.

- `RequestId` gives it an id, and `Measured` counts it for the metrics.
- `Conditional` answers 304, and `Answers` makes problem documents of what the framework says in plain text.
- `Audit` logs who changed what and who was refused.
- `Refuse` has checks. `known_hosts` and `same_site` protect the service from web sites that its users visit;
  `utf8_form` and `no_nul` refuse forms in other encodings than UTF-8, and paths with a character that no text has.
- `BodyLimit` refuses bodies that are too large.

A web site can give its own name the address of this machine, and a browser then takes the service for a part of that
site (DNS rebinding); the name in the Host header shows it. A page of another site can make the browser of somebody who
is on this machine, or has a session here, send requests. A browser says where a request comes from (Fetch metadata,
Origin); other programs do not.
"""

import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from hashlib import sha256
from http import HTTPStatus
from urllib.parse import parse_qsl
from uuid import uuid4

import prometheus_client
import structlog
from fastapi import Response
from prometheus_client import CollectorRegistry, Histogram, ProcessCollector
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from scene_attack.addresses import is_loopback
from scene_attack.errors import InvalidRequest
from scene_attack.logs import logger
from scene_attack_api.asgi import HttpMiddleware
from scene_attack_api.problems import REQUEST_ID, BadRequestField, http_problem, invalid, problem
from scene_attack_api.requests import matches
from scene_attack_service.access.caller import Caller

_SANE = re.compile(r"[A-Za-z0-9._:-]{1,128}")


class RequestId(HttpMiddleware):
    """Takes the id from the client or from a proxy if it is plain text, and makes one otherwise."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Gives the request its id."""
        sent = Headers(scope=scope).get(REQUEST_ID, "")
        scope["request_id"] = sent if _SANE.fullmatch(sent) else uuid4().hex
        # The server runs each request in a task of its own, so this ends with the request.
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request=scope["request_id"])
        await super().answer(scope, receive, send)

    def begin(self, scope: Scope, start: Message) -> None:
        """Sends the id."""
        MutableHeaders(raw=start["headers"])[REQUEST_ID] = scope["request_id"]


METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
BOUNDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
"""Upper bounds of the histogram of answers' times, in seconds."""


class RequestMetrics:
    """The metrics of requests, and the registry that `/metrics` reports."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        self.requests = prometheus_client.Counter(
            "scene_attack_http_requests",
            "Requests that this process of the API answered",
            ["method", "route", "status"],
            registry=self.registry,
        )
        self.seconds = Histogram(
            "scene_attack_http_request_seconds",
            "Time from a request to the beginning of its answer",
            ["method", "route"],
            buckets=BOUNDS,
            registry=self.registry,
        )


class Measured(HttpMiddleware):
    """Counts requests by the template of their route, and measures the time to the beginning of the answer."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        super().__init__(app)
        self.metrics = metrics

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Measures the time."""
        scope["began"] = time.perf_counter()
        try:
            await super().answer(scope, receive, send)
        except BaseException:
            if "began" in scope:  # nothing was answered: the framework does so outside of this
                self.begin(scope, {"status": 500})
            raise

    def begin(self, scope: Scope, start: Message) -> None:
        """Counts the answer."""
        method = scope["method"] if scope["method"] in METHODS else "other"
        route = _template(scope)
        self.metrics.requests.labels(method, route, str(start["status"])).inc()
        self.metrics.seconds.labels(method, route).observe(time.perf_counter() - scope.pop("began"))


def _template(scope: Scope) -> str:
    """The path of the request's route, e.g. "/v1/jobs/{job_id}"; "none" if it has none, or was refused before."""
    return getattr(scope.get("route"), "path_format", None) or "none"


_KEPT = (b"etag", b"cache-control", b"x-content-type-options", b"content-security-policy")
"""Headers of an answer that 304 has, too."""


class Conditional(HttpMiddleware):
    """Adds an ETag to the answers of GET that are JSON, and answers 304 where `If-None-Match` has it."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers 304 or with an ETag."""
        if scope["method"] != "GET":
            return await self.app(scope, receive, send)
        client_etags = Headers(scope=scope).get("if-none-match")
        start: Message | None = None

        async def tagged(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start" and _is_json(message):
                start = message
                return None
            if start is None:
                return await send(message)
            begun, start = start, None
            headers = MutableHeaders(raw=begun["headers"])
            headers["Cache-Control"] = "private, no-cache"
            if not message.get("more_body", False):
                # Weak: compressed or not, the content is the same.
                headers["ETag"] = etag(message["body"])
                if client_etags is not None and matches(client_etags, headers["ETag"]):
                    kept = [(k, v) for k, v in begun["headers"] if k in _KEPT]
                    begun["status"], begun["headers"], message["body"] = 304, kept, b""
            await send(begun)
            await send(message)
            return None

        return await self.app(scope, receive, tagged)


def etag(body: bytes) -> str:
    """The weak ETag of an answer."""
    return f'W/"{sha256(body).hexdigest()[:32]}"'


def _is_json(message: Message) -> bool:
    headers = Headers(raw=message["headers"])
    plain = headers.get("content-type", "").startswith("application/json")
    return bool(message["status"] == 200 and plain and "etag" not in headers)


class Answers(HttpMiddleware):
    """Turns the plain-text errors of the framework's parts, e.g. for ranges, into problem documents.

    It also adds headers to every response by which browsers guess no media type, and load nothing for what is no page.
    """

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Lets the app answer; a problem document takes the place of its plain error."""
        guarded, start, text = self.beginning(scope, send), None, b""

        async def held(message: Message) -> None:
            nonlocal start, text
            if message["type"] == "http.response.start" and _is_plain_error(message):
                start = message
            elif start is None:
                await guarded(message)
            else:
                text += message.get("body", b"")
                if not message.get("more_body", False):
                    await _as_problem(start, text)(scope, receive, guarded)

        await self.app(scope, receive, held)

    def begin(self, scope: Scope, start: Message) -> None:  # noqa: ARG002 - the same for all requests
        """Adds the headers."""
        headers = MutableHeaders(raw=start["headers"])
        headers["x-content-type-options"] = "nosniff"
        headers.setdefault("content-security-policy", "default-src 'none'; frame-ancestors 'none'")


def _as_problem(start: Message, text: bytes) -> Response:
    kept = {
        name: value
        for name, value in Headers(raw=start["headers"]).items()
        if not name.startswith("content-") or name == "content-range"
    }
    detail = text.decode(errors="replace") or HTTPStatus(start["status"]).description
    return problem(start["status"], detail, headers=kept)


def _is_plain_error(message: Message) -> bool:
    headers = dict(message["headers"])
    kind: bytes = headers.get(b"content-type", b"text/plain")
    return bool(message["status"] >= 400) and kind.startswith(b"text/plain")


REFUSED = (400, 401, 403, 421, 429)
READS = ("GET", "HEAD", "OPTIONS")
MAX_LOGGED = 200
"""Characters of a path that a line has."""

log = logger("audit")


class Audit(HttpMiddleware):
    """Logs every request that is no mere reading, and every one that is refused at the door.

    The line has the prefix of the key, its owner, the client's address, the route, the object (the path, or the place
    of what was made) and the status; as every line about a request it has its id. Bodies, queries and keys are not in
    it.
    """

    def begin(self, scope: Scope, start: Message) -> None:
        """Logs the line."""
        status = start["status"]
        if scope["method"] in READS and status not in REFUSED:
            return
        caller = scope.get("state", {}).get("caller")
        who = {"key": caller.key, "owner": caller.owner} if isinstance(caller, Caller) else {"key": None, "owner": None}
        location = Headers(raw=start["headers"]).get("location", "") if status in (201, 202) else ""
        log.info(
            "audit",
            **who,
            client=scope["client"][0] if scope["client"] else None,
            route=f"{scope['method'][:20]} {_template(scope)}",
            object=(location or scope["path"])[:MAX_LOGGED],
            status=status,
        )


Check = Callable[[Scope], Response | None]
"""Returns the answer to a request that is refused, and None for any other."""


class Refuse(HttpMiddleware):
    """Answers a request by the first of `checks` that refuses it."""

    def __init__(self, app: ASGIApp, checks: Sequence[Check]) -> None:
        super().__init__(app)
        self.checks = checks

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers by the first refusal, if there is one."""
        refusals = (refusal for check in self.checks if (refusal := check(scope)) is not None)
        await next(refusals, self.app)(scope, receive, send)


_HOST = re.compile(r"(?:\[([0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*)\]|([A-Za-z0-9._~-]+))(?::[0-9]{0,5})?")
"""An IPv6 address in brackets, or a name or IPv4 address, and perhaps a port."""


def known_hosts(hosts: Collection[str]) -> Check:
    """Refuses by 400 a Host that is none, and by 421 one that is neither loopback nor one of `hosts` (lower case)."""

    def check(scope: Scope) -> Response | None:
        host = Headers(scope=scope).get("host", "")
        name = _hostname(host)
        if host and not name:
            return problem(400, f"{host[:100]!r} is no host")
        if is_loopback(name) or name in hosts:
            return None
        detail = f"this service does not answer for host {host[:100]!r}; SCENE_ATTACK_HOSTS lists those it answers for"
        return problem(421, detail)

    return check


def _hostname(host: str) -> str:
    """The name or address in a Host header, in lower case; "" if it is none."""
    match = _HOST.fullmatch(host)
    return "" if match is None else (match[1] or match[2]).lower()


_OWN = ("same-origin", "none")
"""Values of Sec-Fetch-Site: this service's own pages, and what the user typed. `same-site` is another port."""


def same_site(scope: Scope) -> Response | None:
    """Refuses by 403 other sites' requests, but for a link to a page that the user follows."""
    if _is_foreign(scope["method"], Headers(scope=scope)):
        return problem(403, "requests from other web sites are refused")
    return None


def _is_foreign(method: str, headers: Headers) -> bool:
    reads = method in ("GET", "HEAD")
    origin = headers.get("origin")
    if origin is not None and not reads and origin.partition("://")[2] != headers.get("host"):
        return True
    if headers.get("sec-fetch-site", "none") in _OWN:
        return False
    link = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest", "document") == "document"
    return not (reads and link)


JSON_BYTES = 2**20
"""Largest body that is not an upload."""
FORM_BYTES = 2**16
"""Bytes of the largest form, and those that a multipart form may have in addition to its file."""
DRAIN = 4
"""A body of at most this many times the limit is read and discarded, so that the client receives the answer. The
connection is closed on a larger body."""


class BodyLimit(HttpMiddleware):
    """Answers 413 for bodies over the limit of their path, and reads no more than the limit into memory.

    `uploads` maps a path to the largest size of its file in bytes. There a body that is too large is answered by 422
    for the field `file`. A form of any other path may have FORM_BYTES.
    """

    def __init__(self, app: ASGIApp, uploads: Mapping[str, int]) -> None:
        super().__init__(app)
        self.uploads = uploads

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reads no more of the body than its limit."""
        upload = self.uploads.get(scope["path"])
        most = FORM_BYTES if _form_of(scope) is not None else JSON_BYTES
        limit = most if upload is None else upload + FORM_BYTES
        length = Headers(scope=scope).get("content-length", "")
        if length.isdigit() and int(length) > limit:
            if int(length) <= DRAIN * limit:
                await _drain(receive)
            return await http_problem(_too_large(limit, upload))(scope, receive, send)
        total = 0

        async def counted() -> Message:
            nonlocal total
            message = await receive()
            total += len(message.get("body", b""))
            if total > limit:  # a body without content-length
                raise _too_large(limit, upload)
            return message

        return await self.app(scope, counted, send)


def _too_large(limit: int, upload: int | None) -> HTTPException:
    if upload is None:
        return HTTPException(413, f"the body may have at most {limit:,} bytes")
    return BadRequestField(InvalidRequest("file", f"it may have at most {upload:,} bytes"))


async def _drain(receive: Receive) -> None:
    while True:
        message = await receive()
        if message["type"] != "http.request" or not message.get("more_body", False):
            return


def utf8_form(scope: Scope) -> Response | None:
    """Refuses by 415 a form that names another encoding than UTF-8.

    The framework decodes the fields of a form by the codec that the client names, of all that Python has; some take
    minutes for a megabyte, in which no other request is answered.
    """
    charset = (_form_of(scope) or {}).get(b"charset", b"utf-8").lower()
    return None if charset in (b"utf-8", b"utf8", b"us-ascii") else problem(415, "a form has to be in UTF-8")


def _form_of(scope: Scope) -> dict[bytes, bytes] | None:
    """The parameters of the content type of a form, read as the framework reads them; None if the body is no form."""
    kind, parameters = parse_options_header(Headers(scope=scope).get("content-type"))
    return parameters if kind in _FORMS else None


_FORMS = (b"multipart/form-data", b"application/x-www-form-urlencoded")


def no_nul(scope: Scope) -> Response | None:
    """Refuses paths and queries with the character U+0000, which PostgreSQL takes in no text. `scene_attack.strict`
    refuses it in bodies, HTTP in headers.
    """
    if "\0" in scope["path"]:
        return problem(404, "no path has the character U+0000")
    if b"%00" in scope["query_string"]:
        parameters = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        name = next((name for name, value in parameters if "\0" in value), "query")
        return invalid([InvalidRequest(name, "it has the character U+0000, which no text may have")])
    return None
