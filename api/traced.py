"""Makes a span of each request to the API, in the client's trace if it sends a `traceparent` (W3C Trace Context)."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services import tracing

PREFIX = "/v1/"


class Traced:
    """Traces what is below `PREFIX`; probes, metrics and pages are not traced."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http" or not tracing.on() or not scope["path"].startswith(PREFIX):
            return await self.app(scope, receive, send)
        status = 500

        async def answered(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        method = scope["method"]
        about = {"http.request.method": method, "url.path": scope["path"]}
        with tracing.span(method, Headers(scope=scope).get(tracing.HEADER), "server", about):
            try:
                return await self.app(scope, receive, answered)
            finally:
                route = getattr(scope.get("route"), "path_format", None)
                said = {"http.response.status_code": status, "scene_attack.request.id": scope["request_id"]}
                tracing.describe(
                    said | ({"http.route": route} if route else {}),
                    name=f"{method} {route}" if route else None,
                    error=f"answer {status}" if status >= 500 else None,
                )
