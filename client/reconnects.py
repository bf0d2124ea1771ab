"""How often and after which pauses a dropped event stream is taken up again."""

import httpx

RECONNECTS = 8


class Reconnects:
    """Counts the connections in a row that brought no event."""

    def __init__(self) -> None:
        self._failures = 0

    def succeeded(self) -> None:
        """An event came."""
        self._failures = 0

    def pause(self, error: Exception | None) -> float:
        """Seconds to wait before the next connection; `error` is None if the stream ended before the job did.

        Raises the error, or httpx.RemoteProtocolError for None, after RECONNECTS connections in vain.
        """
        self._failures += 1
        if self._failures > RECONNECTS:
            raise error or httpx.RemoteProtocolError("the event stream keeps ending before the job does")
        return min(0.1 * 2.0**self._failures, 5.0)
