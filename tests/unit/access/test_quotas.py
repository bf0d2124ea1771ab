import pytest

from scene_attack.errors import QuotaExceeded
from scene_attack_service.access.caller import KEYLESS, Caller, OwnedAssets, Quotas

ALICE, BOB = Caller("alice", frozenset(), "sa_1"), Caller("bob", frozenset(), "sa_2")


def test_uploads_are_counted_once_for_each_owner(assets: OwnedAssets) -> None:
    for owner, name, size in (("alice", "a", 60), ("alice", "a", 60), ("alice", "b", 30), ("bob", "a", 60)):
        assets.add(owner, name, size)
    assert [assets.used(owner) for owner in ("alice", "bob", "")] == [90, 60, 0]
    for caller, seen in ((ALICE, "ab"), (BOB, "a"), (KEYLESS, "abc")):
        assert [name for name in "abc" if assets.visible(caller)(name)] == list(seen)


def test_an_owner_uploads_no_more_than_it_may(assets: OwnedAssets) -> None:
    quotas = Quotas(assets, queued=5, campaigns=7, upload_bytes=100)
    assets.add("alice", "a", 60)
    quotas.check_upload("alice", 40)
    with pytest.raises(QuotaExceeded, match="100 bytes"):
        quotas.check_upload("alice", 41)
    quotas.check_upload("bob", 100)


def test_a_service_without_keys_has_no_quotas(assets: OwnedAssets) -> None:
    quotas = Quotas(assets, queued=5, campaigns=7, upload_bytes=0)
    quotas.check_upload("", 10**12)
    assert (quotas.queued_of(""), quotas.queued_of("alice")) == (None, 5)
    assert (quotas.campaigns_of(""), quotas.campaigns_of("alice")) == (None, 7)
