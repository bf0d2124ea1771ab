"""An owner that has too much is told when to try again; others are not held up."""

import pytest

from scene_attack_service.access.caller import Quotas
from tests.unit.api.guarded import ATTACK, CAMPAIGN, SPHERE, Guarded
from tests.unit.api.test_owners import upload

JOB = {"scene": SPHERE, "attack": ATTACK}


@pytest.fixture
def nothing_more(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> Guarded:
    """The service with quotas that are used up by one job, one campaign and no upload."""
    quotas = Quotas(guarded.services.assets, queued=1, campaigns=1, upload_bytes=0)
    for name in ("queued", "campaigns", "upload_bytes"):
        monkeypatch.setitem(vars(guarded.services.quotas), name, vars(quotas)[name])
    return guarded


def test_too_many_queued_jobs(nothing_more: Guarded) -> None:
    answer = nothing_more.client.post("/v1/jobs", json=JOB, headers=nothing_more.headers["alice"])
    assert answer.status_code == 429, answer.text
    assert int(answer.headers["retry-after"]) > 0
    assert "1 jobs queued" in answer.json()["detail"]
    mine = nothing_more.client.post("/v1/jobs", json=JOB, headers=nothing_more.headers["bob"])
    assert mine.status_code == 202
    nothing_more.client.post(f"{mine.headers['location']}/cancel", headers=nothing_more.headers["bob"])


def test_too_many_campaigns_that_have_not_ended(nothing_more: Guarded) -> None:
    answer = nothing_more.client.post("/v1/campaigns", json=CAMPAIGN, headers=nothing_more.headers["alice"])
    assert answer.status_code == 429, answer.text
    assert int(answer.headers["retry-after"]) > 0
    assert "1 campaigns" in answer.json()["detail"]


def test_too_many_uploaded_bytes(nothing_more: Guarded) -> None:
    answer = upload(nothing_more, "alice")
    assert answer.status_code == 429, answer.text
    assert int(answer.headers["retry-after"]) > 0
