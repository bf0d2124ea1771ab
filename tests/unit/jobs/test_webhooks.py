import json
from itertools import pairwise

import pytest
from sqlalchemy import Engine
from sqlalchemy.exc import StatementError

from services.errors import InvalidRequest
from services.jobs.repository import Repository
from services.jobs.webhooks import ATTEMPTS, FIRST_SECONDS, KEPT, MOST, Webhooks, wait
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import SPEC, add, start

URL = "https://receiver.example/hook"


@pytest.fixture
def webhooks(engine: Engine, clock: Clock) -> Webhooks:
    return Webhooks(engine, clock)


def test_the_end_of_a_job_is_told_to_the_webhooks_of_its_owner(repository: Repository, webhooks: Webhooks) -> None:
    mine = [webhooks.create("", URL), webhooks.create("", f"{URL}/2")]
    webhooks.create("another", URL)
    job = add(repository)
    assert webhooks.take(9, 60, 9) == []
    repository.fail(start(repository, job), "timeout", "too long")
    messages = webhooks.take(9, 60, 9)
    assert sorted(one.url for one in messages) == sorted(one.url for one in mine)
    assert {one.secret for one in messages} == {one.secret for one in mine}
    told = json.loads(messages[0].body)
    assert told["type"] == "job.failed"
    assert told["timestamp"].startswith("2030-01-01T00:00:00")
    assert told["data"] == {
        "id": job.id,
        "name": "sphere",
        "state": "failed",
        "attempt": 1,
        "failure": {"kind": "timeout", "detail": "too long"},
    }


def test_nothing_is_told_of_a_change_that_is_undone(repository: Repository, webhooks: Webhooks) -> None:
    webhooks.create("", URL)
    attempt = start(repository, add(repository))
    with pytest.raises((StatementError, TypeError)):
        repository.succeed(attempt, {"not": {1j}}, {}, [])
    assert webhooks.take(9, 60, 9) == []


def test_a_message_is_due_again_until_it_is_delivered(repository: Repository, webhooks: Webhooks, clock: Clock) -> None:
    hook = webhooks.create("", URL)
    repository.request_cancel(add(repository).id)
    [first] = webhooks.take(9, 60, 9)
    assert webhooks.take(9, 60, 9) == []
    clock.advance(61)  # the process that took it has died
    [second] = webhooks.take(9, 60, 9)
    assert (second.id, second.body, second.attempt) == (first.id, first.body, 2)
    webhooks.ended(first, 200, None)  # by the process that was thought dead
    webhooks.ended(second, 500, "it answered 500")
    clock.advance(wait(second.id, 2) - 0.1)
    assert webhooks.take(9, 60, 9) == []
    clock.advance(0.2)
    [third] = webhooks.take(9, 60, 9)
    webhooks.ended(third, 204, None)
    [told] = webhooks.deliveries(hook.id)
    assert (told.attempts, told.status, told.error, told.due_at) == (3, 204, None, None)
    assert told.delivered_at == clock()


def test_a_message_is_given_up_and_forgotten(repository: Repository, webhooks: Webhooks, clock: Clock) -> None:
    hook = webhooks.create("", URL)
    repository.request_cancel(add(repository).id)
    for attempt in range(1, ATTEMPTS + 1):
        [message] = webhooks.take(9, 60, 9)
        assert message.attempt == attempt
        webhooks.ended(message, None, "no answer")
        clock.advance(50_000)
    assert webhooks.take(9, 60, 9) == []
    [told] = webhooks.deliveries(hook.id)
    assert (told.delivered_at, told.error) == (None, "no answer")
    webhooks.sweep()
    assert len(webhooks.deliveries(hook.id)) == 1
    clock.advance(KEPT.total_seconds())
    webhooks.sweep()
    assert webhooks.deliveries(hook.id) == []


def test_what_a_late_attempt_says_is_not_recorded(repository: Repository, webhooks: Webhooks, clock: Clock) -> None:
    """Its process hung for so long that the message was sent again."""
    hook = webhooks.create("", URL)
    repository.request_cancel(add(repository).id)
    [first] = webhooks.take(9, 60)
    clock.advance(61)
    [second] = webhooks.take(9, 60)
    webhooks.ended(second, 204, None)
    webhooks.ended(first, 500, "it answered 500")
    [told] = webhooks.deliveries(hook.id)
    assert (told.attempts, told.status, told.error, told.due_at) == (2, 204, None, None)


def test_waits_grow_and_are_spread_by_the_message() -> None:
    first = [wait(f"msg_{k}", 1) for k in range(200)]
    assert 0.75 * FIRST_SECONDS <= min(first) < 0.8 * FIRST_SECONDS
    assert 1.2 * FIRST_SECONDS < max(first) <= 1.25 * FIRST_SECONDS
    assert wait("msg_1", 3) == wait("msg_1", 3)
    waits = [wait("msg_1", attempt) for attempt in range(1, ATTEMPTS)]
    assert all(later > 1.5 * sooner for sooner, later in pairwise(waits))
    assert 10 * 3600 < sum(waits) < 18 * 3600


def test_webhooks_are_counted_and_deleted_by_their_owner_only(repository: Repository, webhooks: Webhooks) -> None:
    made = [webhooks.create("me", URL) for _ in range(MOST)]
    with pytest.raises(InvalidRequest, match="delete one first"):
        webhooks.create("me", URL)
    assert len({one.secret for one in made}) == MOST
    webhooks.create("you", URL)
    assert len(webhooks.all("me")) == MOST
    assert len(webhooks.all(None)) == MOST + 1
    assert not webhooks.remove(made[0].id, "you")
    job, _ = repository.create(SPEC, 9, None, lambda _: {}, owner="me")
    assert job is not None
    repository.request_cancel(job.id)
    assert webhooks.remove(made[0].id, "me")
    assert len(webhooks.take(99, 60, 99)) == MOST - 1


def test_owners_take_turns_and_have_a_few_messages_on_their_way(
    repository: Repository, webhooks: Webhooks, clock: Clock
) -> None:
    for owner, hooks, jobs in (("many", 3, 4), ("few", 1, 2)):
        for _ in range(hooks):
            webhooks.create(owner, URL)
        for _ in range(jobs):
            clock.advance(1)
            job, _ = repository.create(SPEC, 99, None, lambda _: {}, owner=owner)
            assert job is not None
            repository.request_cancel(job.id)
    first = webhooks.take(3, 60, 2)
    assert [one.owner for one in first] == ["many", "few", "many"]
    assert [one.owner for one in webhooks.take(9, 60, 2, {"many": 2, "few": 1})] == ["few"]
    assert webhooks.take(9, 60, 2, {"many": 2}) == []
    assert [one.owner for one in webhooks.take(9, 60, 9, {"many": 2})] == ["many"] * 7
    assert webhooks.take(0, 60) == []
