"""The base class of the API's middleware."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class HttpMiddleware:
    """Passes on whatever is no HTTP request. A derived class has one of the methods, or both."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        await (self.answer if scope["type"] == "http" else self.app)(scope, receive, send)

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers a request. By default the app answers."""
        await self.app(scope, receive, self.beginning(scope, send))

    def beginning(self, scope: Scope, send: Send) -> Send:
        """Returns `send`, before which `begin` is called with the start of the answer."""

        async def begun(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.begin(scope, message)
            await send(message)

        return begun

    def begin(self, scope: Scope, start: Message) -> None:
        """Looks at the start of an answer, with its status and headers, or changes it."""
