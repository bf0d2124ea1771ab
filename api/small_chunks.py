"""A limit on the number of chunks of a request's body.

A byte that comes as a chunk of its own takes six on the wire and 20 µs of the processor: a body of a megabyte kept all
other requests waiting for 20 s, within every limit of size and time.
"""

from typing import Any

import h11

MOST = 1000
"""Chunks that every body may have,"""
LEAST_BYTES = 512
"""and bytes per chunk, on average, of a body that has more."""


class CountedChunks(h11.Connection):
    """HTTP/1.1 in which a body of too many small chunks is none."""

    _chunks = 0
    _bytes = 0

    def next_event(self) -> Any:
        """The next event. Raises RemoteProtocolError, also where the chunks are too small."""
        event = super().next_event()
        if isinstance(event, h11.Request):
            self._chunks = self._bytes = 0
        elif isinstance(event, h11.Data):
            self._chunks += event.chunk_start
            self._bytes += len(event.data)
            if self._chunks > MOST + self._bytes // LEAST_BYTES:
                raise h11.RemoteProtocolError("the body has too many small chunks")
        return event
