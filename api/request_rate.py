"""How many requests an owner may send: a token bucket for each owner, in the memory of this process of the API."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class _Bucket:
    """The requests that an owner may send at once, as of a time."""

    left: float
    at: float


class RequestRate:
    """Admits `per_minute` requests at once, and as many again over each minute. The owner "" is not counted.

    Several processes of the API count each for itself.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most = float(per_minute)
        self._clock = clock
        self._buckets: dict[str, _Bucket] = {}

    def wait(self, owner: str) -> float:
        """Seconds until the owner may send this request; 0 if now, and the request is then counted."""
        if not owner:
            return 0.0
        now = self._clock()
        bucket = self._buckets.setdefault(owner, _Bucket(self._most, now))
        bucket.left = min(self._most, bucket.left + (now - bucket.at) * self._most / 60)
        bucket.at = now
        if bucket.left < 1:
            return (1 - bucket.left) * 60 / self._most
        bucket.left -= 1
        return 0.0
