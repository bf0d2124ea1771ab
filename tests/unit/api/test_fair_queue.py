import pytest

from api.fair_queue import FairQueue


def taken(queue: FairQueue[str]) -> list[str]:
    return [queue.take().what for _ in range(len(queue))]


def test_clients_take_turns_however_many_requests_one_has() -> None:
    queue: FairQueue[str] = FairQueue()
    for number in range(3):
        queue.add(f"a{number}", "a", 1)
    queue.add("b0", "b", 1)
    queue.add("b1", "b", 1)
    assert taken(queue) == ["a0", "b0", "a1", "b1", "a2"]


def test_the_cheapest_of_a_turn_goes_first() -> None:
    queue: FairQueue[str] = FairQueue()
    for client, cost in (("a", 9), ("b", 1), ("c", 4)):
        queue.add(client, client, cost)
    assert taken(queue) == ["b", "c", "a"]


def test_a_request_that_runs_counts_for_its_client() -> None:
    queue: FairQueue[str] = FairQueue()
    queue.add("a0", "a", 1)
    running = queue.take()
    queue.add("a1", "a", 1)
    queue.add("b0", "b", 9)
    assert taken(queue) == ["b0", "a1"]
    queue.done(running)


def test_a_client_begins_anew_when_all_its_requests_are_answered() -> None:
    queue: FairQueue[str] = FairQueue()
    for place in [queue.add(f"a{number}", "a", 1) for number in range(3)]:
        assert queue.drop(place)
    queue.add("a3", "a", 1)
    queue.add("b0", "b", 2)
    assert taken(queue) == ["a3", "b0"]


def test_a_request_that_was_taken_is_not_dropped() -> None:
    queue: FairQueue[str] = FairQueue()
    place = queue.add("a", "a", 1)
    assert queue.take() is place
    assert not queue.drop(place)
    with pytest.raises(ValueError, match="empty"):
        queue.take()
