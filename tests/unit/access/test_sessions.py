import pytest
from sqlalchemy import Engine, select

from scene_attack_service.access.caller import Scope
from scene_attack_service.access.keys import SESSION_SECONDS, AccessKeys, DashboardSession, Sessions
from tests.unit.jobs.conftest import Clock


@pytest.fixture
def sessions(engine: Engine, clock: Clock) -> Sessions:
    return Sessions(engine, clock)


@pytest.fixture
def prefix(keys: AccessKeys) -> str:
    return keys.create("ci", "alice", {Scope.JOBS_READ})[0].prefix


def test_a_session_is_found_by_its_text_until_it_is_ended(sessions: Sessions, prefix: str) -> None:
    text, other = sessions.begin(prefix), sessions.begin(prefix)
    assert sessions.key_of(text) == sessions.key_of(other) == prefix
    for wrong in ("", prefix, text[:-1], "x" * 10_000, "\ud800"):
        assert sessions.key_of(wrong) is None
    sessions.end(text)
    assert sessions.key_of(text) is None
    assert sessions.key_of(other) == prefix
    sessions.end("unknown")


def test_a_session_ends_by_itself_and_is_forgotten(
    sessions: Sessions, prefix: str, clock: Clock, engine: Engine
) -> None:
    text = sessions.begin(prefix)
    clock.advance(SESSION_SECONDS - 1)
    assert sessions.key_of(text) == prefix
    clock.advance(1)
    assert sessions.key_of(text) is None
    sessions.begin(prefix)
    with engine.connect() as connection:
        [left] = connection.execute(select(DashboardSession.__table__)).all()
    assert text not in str(left)


def test_a_key_that_is_revoked_or_expired_is_none_for_its_sessions(keys: AccessKeys, prefix: str, clock: Clock) -> None:
    assert keys.of_prefix(prefix) is not None
    brief = keys.create("ci", "alice", {Scope.JOBS_READ}, 60)[0].prefix
    clock.advance(60)
    assert keys.of_prefix(brief) is None
    keys.revoke(prefix)
    assert keys.of_prefix(prefix) is None
    assert keys.of_prefix("sa_none") is None
