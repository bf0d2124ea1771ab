"""Middleware that refuses requests before they are parsed: bodies that are too large, forms in other encodings than
UTF-8, addresses with a character that no text may have, and more uploads of a client than may be open.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from urllib.parse import parse_qsl

from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.authentication import client_of
from api.problems import BadRequestField, http_problem, invalid, problem
from services.access.caller import Caller
from services.errors import InvalidRequest

JSON_BYTES = 2**20
"""Largest body that is not an upload."""
FORM_BYTES = 2**16
"""Bytes of the largest form, and those that a multipart form may have in addition to its file."""
DRAIN = 4
"""A body of at most this many times the limit is read and discarded, so that the client receives the answer. The
connection is closed on a larger body."""


class BodyLimit:
    """Answers 413 for bodies over the limit of their path, and reads no more than the limit into memory.

    `uploads` maps a path to the largest size of its file in bytes. There a body that is too large is answered by 422
    for the field `file`. A form of any other path may have FORM_BYTES.
    """

    def __init__(self, app: ASGIApp, uploads: Mapping[str, int]) -> None:
        self.app = app
        self.uploads = uploads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
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


class Utf8Forms:
    """Answers 415 for a form that names another encoding than UTF-8.

    The framework decodes the fields of a form by the codec that the client names, of all that Python has; some take
    minutes for a megabyte, in which no other request is answered.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] == "http":
            charset = (_form_of(scope) or {}).get(b"charset", b"utf-8").lower()
            if charset not in (b"utf-8", b"utf8", b"us-ascii"):
                return await problem(415, "a form has to be in UTF-8")(scope, receive, send)
        return await self.app(scope, receive, send)


def _form_of(scope: Scope) -> dict[bytes, bytes] | None:
    """The parameters of the content type of a form, read as the framework reads them; None if the body is no form."""
    kind, parameters = parse_options_header(Headers(scope=scope).get("content-type"))
    return parameters if kind in _FORMS else None


_FORMS = (b"multipart/form-data", b"application/x-www-form-urlencoded")


class NoNul:
    """Refuses paths and queries with the character U+0000, which PostgreSQL takes in no text. `services.strict` refuses
    it in bodies, HTTP in headers.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        if "\0" in scope["path"]:
            return await problem(404, "no path has the character U+0000")(scope, receive, send)
        if b"%00" in scope["query_string"]:
            parameters = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
            name = next((name for name, value in parameters if "\0" in value), "query")
            refused = InvalidRequest(name, "it has the character U+0000, which no text may have")
            return await invalid([refused])(scope, receive, send)
        return await self.app(scope, receive, send)


MOST = 8
"""Uploads of one client at the same time; two of all clients are parsed at once."""
RETRY_SECONDS = 5


class OpenUploads:
    """Answers 429 to an upload to one of `paths` of a client that has `most` open on all of them: the same owner, or
    address without keys.
    """

    def __init__(self, app: ASGIApp, paths: Collection[str], most: int = MOST) -> None:
        self.app = app
        self.paths = paths
        self.most = most
        self._open: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http" or scope["method"] != "POST" or scope["path"] not in self.paths:
            return await self.app(scope, receive, send)
        caller = scope["state"]["caller"]
        assert isinstance(caller, Caller)  # the route needs a key, or there is none
        client = client_of(Request(scope), caller)
        if self._open[client] >= self.most:
            detail = f"{self.most} uploads of yours are open already; send the next when one has been answered"
            return await problem(429, detail, headers={"Retry-After": str(RETRY_SECONDS)})(scope, receive, send)
        self._open[client] += 1
        is_open = True

        def close() -> None:
            nonlocal is_open
            if is_open:
                is_open = False
                self._open[client] -= 1
                if not self._open[client]:
                    del self._open[client]

        async def answered(message: Message) -> None:
            if message["type"] == "http.response.start":  # whoever has the answer may send the next one
                close()
            await send(message)

        try:
            return await self.app(scope, receive, answered)
        finally:
            close()
