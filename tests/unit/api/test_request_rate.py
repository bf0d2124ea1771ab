import pytest

from api.request_rate import RequestRate


class Seconds:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def seconds() -> Seconds:
    return Seconds()


def test_as_many_as_a_minute_has_at_once_and_then_one_at_a_time(seconds: Seconds) -> None:
    rate = RequestRate(30, seconds)
    assert [rate.wait("alice") for _ in range(30)] == [0.0] * 30
    assert rate.wait("alice") == pytest.approx(2.0)
    seconds.now += 1.5
    assert rate.wait("alice") == pytest.approx(0.5)
    seconds.now += 0.5
    assert [rate.wait("alice") > 0 for _ in range(2)] == [False, True]


def test_a_pause_saves_no_more_than_a_minute(seconds: Seconds) -> None:
    rate = RequestRate(3, seconds)
    rate.wait("alice")
    seconds.now += 10_000
    assert [rate.wait("alice") > 0 for _ in range(4)] == [False, False, False, True]


def test_one_owner_does_not_use_up_anothers_and_the_keyless_have_no_limit(seconds: Seconds) -> None:
    rate = RequestRate(1, seconds)
    assert [rate.wait(owner) > 0 for owner in ("alice", "alice", "bob", "", "", "")] == [
        False,
        True,
        False,
        False,
        False,
        False,
    ]
