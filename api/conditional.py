"""Conditional requests: a JSON answer names its content, and a client that has it gets 304."""

import re
from hashlib import sha256

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

THREADED = 2**16
"""Bytes of an answer from which on it is hashed in a thread, so that the event loop answers others meanwhile."""
_KEPT = (b"etag", b"cache-control", b"x-content-type-options", b"content-security-policy")
"""Headers of an answer that 304 has, too."""


class Conditional:
    """Adds an ETag to the answers of GET that are JSON, and answers 304 where `If-None-Match` has it."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http" or scope["method"] != "GET":
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
                body = message["body"]
                headers["ETag"] = await run_in_threadpool(etag, body) if len(body) >= THREADED else etag(body)
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


def matches(if_none_match: str, etag: str) -> bool:
    """Whether an `If-None-Match` has an ETag, weak or strong, or `*`."""
    name = etag.removeprefix("W/").strip('"')
    return if_none_match.strip() == "*" or name in re.findall(r'"([^"]*)"', if_none_match)
