from hashlib import sha256

import pytest
from sqlalchemy import Engine, event, select
from sqlalchemy.exc import OperationalError

from scene_attack_service.access.caller import Caller, Scope
from scene_attack_service.access.keys import USE_SECONDS, AccessKey, AccessKeys
from tests.unit.jobs.conftest import Clock

pytestmark = pytest.mark.slow

READ = {Scope.JOBS_READ}


def test_a_key_is_found_by_its_text_alone(keys: AccessKeys) -> None:
    made, text = keys.create("ci", "alice", {Scope.JOBS_WRITE, Scope.JOBS_READ})
    found = keys.find(text)
    assert found is not None
    assert (found.prefix, found.name, found.owner) == (made.prefix, "ci", "alice")
    assert found.scopes == ["jobs:read", "jobs:write"]
    assert text.startswith(f"{made.prefix}_")
    for wrong in ("", made.prefix, made.digest, text[:-1], f"{text} ", text.swapcase(), "\ud800", "x" * 10_000):
        assert keys.find(wrong) is None


def test_only_the_hash_of_a_key_is_in_the_database(keys: AccessKeys, engine: Engine) -> None:
    made, text = keys.create("ci", "alice", READ)
    with engine.connect() as connection:
        stored = str(connection.execute(select(AccessKey.__table__)).one())
    assert sha256(text.encode()).hexdigest() in stored
    assert text.removeprefix(f"{made.prefix}_") not in stored


def test_keys_have_256_random_bits_of_their_own(keys: AccessKeys) -> None:
    texts = [keys.create("ci", "alice", READ)[1] for _ in range(20)]
    assert len({text.split("_", 2)[2] for text in texts}) == 20
    assert all(len(text.split("_", 2)[2]) == 43 for text in texts)  # 32 bytes in base64


def test_a_revoked_key_is_found_no_more_and_stays_revoked(keys: AccessKeys, clock: Clock) -> None:
    made, text = keys.create("ci", "alice", READ)
    revoked = keys.revoke(made.prefix)
    assert revoked is not None
    assert revoked.revoked_at == clock.now
    clock.advance(5)
    again = keys.revoke(made.prefix)
    assert again is not None
    assert again.revoked_at == revoked.revoked_at
    assert keys.find(text) is None
    assert keys.revoke("sa_0000000000") is None


def test_a_key_expires(keys: AccessKeys, clock: Clock) -> None:
    _, text = keys.create("ci", "alice", READ, seconds=60)
    clock.advance(59)
    assert keys.find(text) is not None
    clock.advance(1)
    assert keys.find(text) is None


def test_a_use_is_recorded_once_a_minute(engine: Engine, clock: Clock) -> None:
    elapsed = 1000.0
    keys = AccessKeys(engine, clock, lambda: elapsed)
    made, _ = keys.create("ci", "alice", READ)
    other, _ = keys.create("ci", "bob", READ)
    assert keys.use_is_due(made.prefix)
    keys.record_use(made.prefix)
    assert [key.last_used_at for key in sorted(keys.all(), key=lambda key: key.owner)] == [clock.now, None]
    assert not keys.use_is_due(made.prefix)
    assert keys.use_is_due(other.prefix)
    elapsed += USE_SECONDS - 0.5
    assert not keys.use_is_due(made.prefix)
    elapsed += 0.5
    assert keys.use_is_due(made.prefix)


def test_a_use_that_cannot_be_recorded_is_allowed(keys: AccessKeys, engine: Engine) -> None:
    made, _ = keys.create("ci", "alice", READ)

    def refuse(*_: object) -> None:
        raise OperationalError("UPDATE", {}, Exception("the disk is full"))

    event.listen(engine, "before_cursor_execute", lambda *given: refuse() if given[2].startswith("UPDATE") else None)
    keys.record_use(made.prefix)
    assert keys.all()[0].last_used_at is None


def test_keys_exist_also_when_all_are_revoked(keys: AccessKeys) -> None:
    assert not keys.exist()
    made, _ = keys.create("ci", "alice", READ)
    keys.revoke(made.prefix)
    assert keys.exist()


def test_scopes_allow_what_they_say_and_admin_everything() -> None:
    reader = Caller.of("alice", ["jobs:read", "jobs:everything"], "sa_1")
    assert [scope for scope in Scope if reader.may(scope)] == [Scope.JOBS_READ]
    assert all(Caller.of("root", ["admin"], "sa_2").may(scope) for scope in Scope)
    assert not any(Caller.of("nobody", [], "sa_3").may(scope) for scope in Scope)


def test_which_of_some_keys_have_ended(keys: AccessKeys, clock: Clock) -> None:
    assert keys.ended([]) == set()
    assert keys.ended([""]) == set()  # there is no key yet
    valid, revoked, expiring = (
        keys.create(name, "alice", {Scope.JOBS_READ}, seconds)[0].prefix
        for name, seconds in (("valid", None), ("revoked", None), ("expiring", 60.0))
    )
    keys.revoke(revoked)
    asked = [valid, revoked, expiring, "sa_unknown", ""]
    assert keys.ended(asked) == {revoked, "sa_unknown", ""}
    clock.advance(61)
    assert keys.ended(asked) == {revoked, expiring, "sa_unknown", ""}
