"""The order in which waiting requests get a process: clients in turn, and of one client's the cheapest first."""

from collections import Counter
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Place(Generic[T]):
    """A request's place in the queue. `rank` is the number of its client's requests that were open when it came."""

    rank: int
    cost: float
    number: int
    client: Hashable
    what: T

    @property
    def order(self) -> tuple[int, float, int]:
        """The smallest goes first: a client's n-th request waits for no other client's request after its n-th."""
        return self.rank, self.cost, self.number


class FairQueue(Generic[T]):
    """Waiting requests. A request is open from `add` until `done`."""

    def __init__(self) -> None:
        self._waiting: list[Place[T]] = []
        self._open: Counter[Hashable] = Counter()
        self._number = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, what: T, client: Hashable, cost: float) -> Place[T]:
        """Adds a request of a client, and returns its place."""
        self._number += 1
        place = Place(self._open[client], cost, self._number, client, what)
        self._open[client] += 1
        self._waiting.append(place)
        return place

    def take(self) -> Place[T]:
        """Removes and returns the request whose turn it is. Raises ValueError if none waits."""
        place = min(self._waiting, key=lambda one: one.order)
        self._waiting.remove(place)
        return place

    def drop(self, place: Place[T]) -> bool:
        """Removes a request that is wanted no more. Returns False if it has been taken already."""
        if place not in self._waiting:
            return False
        self._waiting.remove(place)
        self.done(place)
        return True

    def done(self, place: Place[T]) -> None:
        """Records that a request has been answered."""
        self._open[place.client] -= 1
        if not self._open[place.client]:
            del self._open[place.client]
