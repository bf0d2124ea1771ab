"""Campaigns in the record, moved on by the supervisor's feeder; the worker is played by the test."""

from copy import deepcopy
from typing import Any

import pytest
from sqlalchemy import Engine, update

from scene_attack.errors import QuotaExceeded
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.result import Result, outcome
from scene_attack.runs.spec import JobSpec, digest
from scene_attack.runs.spec import parse as parse_job
from scene_attack_service.jobs.campaigns import CHUNK, Feeder
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.jobs import Key, KeyReused
from scene_attack_service.jobs.models import Campaign, CampaignState, State
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.campaign_stage import QUEUED, Stage, spec
from tests.unit.jobs.records import add, attacks

pytestmark = pytest.mark.slow


@pytest.fixture
def stage(engine: Engine, record: Record) -> Stage:
    return Stage(engine, record)


def test_an_owner_has_no_more_open_campaigns_than_it_may(stage: Stage) -> None:
    def begin(owner: str, most: int | None = 2, key: str | None = None) -> Campaign:
        one = spec(1)
        return stage.campaigns.submit(one, key, owner, owner_campaigns=most)

    first, second = begin("alice", key="k"), begin("alice")
    stage.campaigns.pause(second.id)
    with pytest.raises(QuotaExceeded, match="2 campaigns"):
        begin("alice")
    assert begin("alice", key="k").id == first.id
    begin("bob")
    begin("alice", None)
    for ended in (first, second):
        stage.campaigns.cancel(ended.id)
    begin("alice")
    with pytest.raises(QuotaExceeded):
        begin("alice")


def test_a_campaign_is_selected_run_and_finished(stage: Stage) -> None:
    campaign = stage.begin(spec(CHUNK + 1))
    stage.feeder.tick()
    assert [len(job.spec["views"]) for job in stage.queued()] == [CHUNK, 1]
    for job in stage.queued():
        stage.work(job)
    stage.feeder.tick()
    assert stage.state(campaign) is CampaignState.RUNNING
    progress = stage.campaigns.progress([campaign])[campaign]
    assert (progress.views_answered, progress.jobs, progress.ended) == (CHUNK + 1, CHUNK + 1, 0)
    stage.finish(campaign)
    planned, cases = stage.campaigns.cases(campaign)
    assert planned == [("efficientnet-lite0", "normals")] * (CHUNK + 1)
    assert all(case.success and case.right and case.run_seconds == 0.0 for case in cases)
    assert len(stage.campaigns.curves(campaign)) == CHUNK + 1
    # selection jobs are in no list
    assert len(attacks(stage.record)) == CHUNK + 1
    assert {job.campaign_id for job in attacks(stage.record, f"campaign:{campaign}")} == {campaign}
    stage.feeder.tick()
    assert stage.state(campaign) is CampaignState.FINISHED


def test_never_more_than_a_few_jobs_are_queued_and_campaigns_take_turns(stage: Stage) -> None:
    first, second = stage.begin(spec(9)), stage.begin(spec(8, seed=1))
    stage.selected(first)
    stage.selected(second)
    for _ in range(3):
        stage.feeder.tick()
        queued = stage.queued()
        assert len(queued) == QUEUED
        assert {job.campaign_id for job in queued} == {first, second}
        single = add(stage.record)
        assert stage.queued()[-1].id == single.id  # behind QUEUED jobs at most
        stage.work(single)
        for job in queued:
            stage.work(job)


def test_a_wrong_first_answer_is_not_attacked_and_said(stage: Stage) -> None:
    campaign = stage.begin(spec(2))
    stage.feeder.tick()
    [job] = stage.queued()
    stage.work(job, right=False)
    stage.feeder.tick()
    stage.feeder.tick()
    assert stage.state(campaign) is CampaignState.FINISHED
    assert [view["why"] for view in stage.campaign(campaign).views or []] == [
        "the network says teapot, which is wrong"
    ] * 2
    assert stage.campaigns.cases(campaign) == ([], [])


def test_the_views_of_a_failed_selection_are_refused_with_its_reason(stage: Stage) -> None:
    campaign = stage.begin(spec(CHUNK + 1))
    stage.feeder.tick()
    bad, good = stage.queued()
    attempt = stage.record.leases.lease(bad.id, "w", 20)
    assert attempt is not None
    stage.record.leases.fail(attempt, "worker-lost", "its process died 3 times")
    stage.work(good)
    stage.feeder.tick()
    found = stage.campaign(campaign).views or []
    assert [view["chosen"] for view in found] == [False] * CHUNK + [True]
    assert "worker-lost: its process died 3 times" in found[0]["why"]


def test_a_paused_campaign_holds_its_queued_jobs_back(stage: Stage, engine: Engine) -> None:
    campaign = stage.begin(spec(5))
    stage.selected(campaign)
    stage.feeder.tick()
    running, *held = stage.queued()
    attempt = stage.record.leases.lease(running.id, "w", 20)
    assert attempt is not None
    paused = stage.campaigns.pause(campaign)
    assert paused is not None
    assert paused.state is CampaignState.PAUSED
    assert stage.queued() == []
    assert stage.record.leases.lease(held[0].id, "w", 20) is None
    # another supervisor, after a restart, holds them back too; what ran to its end is counted
    made = stage.result(parse_job(running.spec))
    stage.record.leases.succeed(attempt, made, outcome(Result.model_validate(made)), [])
    restarted = Feeder(Database(engine), QUEUED)
    restarted.tick()
    assert stage.queued() == []
    assert stage.campaigns.progress([campaign])[campaign].ended == 1
    single = add(stage.record)
    assert [job.id for job in stage.queued()] == [single.id]
    stage.campaigns.resume(campaign)
    assert {job.id for job in held} < {job.id for job in stage.queued()}
    stage.finish(campaign)
    assert len(stage.campaigns.cases(campaign)[1]) == 5


def test_a_campaign_paused_while_it_selects_goes_on_selecting(stage: Stage) -> None:
    campaign = stage.begin(spec(2))
    stage.feeder.tick()
    stage.campaigns.pause(campaign)
    stage.feeder.tick()
    assert stage.queued() == []
    resumed = stage.campaigns.resume(campaign)
    assert resumed is not None
    assert resumed.state is CampaignState.SELECTING
    stage.finish(campaign)


def test_a_cancelled_campaign_cancels_its_jobs(stage: Stage) -> None:
    campaign = stage.begin(spec(5))
    stage.selected(campaign)
    stage.feeder.tick()
    running, *queued = stage.queued()
    attempt = stage.record.leases.lease(running.id, "w", 20)
    assert attempt is not None
    stage.campaigns.cancel(campaign)
    states = [stage.record.jobs.get(job.id) for job in [running, *queued]]
    assert [job.state for job in states if job] == [State.CANCELLING, State.CANCELLED, State.CANCELLED]
    stage.record.leases.cancelled(attempt)
    stage.feeder.tick()
    assert stage.queued() == []
    assert [case.state for case in stage.campaigns.cases(campaign)[1]] == ["cancelled"] * 3
    assert stage.state(campaign) is CampaignState.CANCELLED
    for move in (stage.campaigns.pause, stage.campaigns.resume, stage.campaigns.cancel):
        ended = move(campaign)
        assert ended is not None
        assert ended.state is CampaignState.CANCELLED


def test_an_earlier_result_of_the_same_request_is_taken(stage: Stage) -> None:
    first = stage.begin(spec(3))
    stage.finish(first)
    count = len(attacks(stage.record))
    again = stage.begin(spec(4, name="again"))
    stage.finish(again)
    assert len(attacks(stage.record)) == count + 1
    assert [case.reused for case in stage.campaigns.cases(again)[1]] == [True] * 3 + [False]
    other = stage.begin(spec(3, name="afresh", reuse=False))
    stage.finish(other)
    assert len(attacks(stage.record)) == count + 4


def test_another_owners_result_is_not_taken(stage: Stage) -> None:
    stage.finish(stage.begin(spec(2), "alice"))
    count = len(attacks(stage.record, owner="bob"))
    for owner, reused in (("bob", False), ("", False), ("alice", True)):
        again = stage.begin(spec(2), owner)
        stage.finish(again)
        assert [case.reused for case in stage.campaigns.cases(again)[1]] == [reused] * 2
    assert len(attacks(stage.record, owner="bob")) == count + 2  # jobs belong to whom the campaign does


@pytest.mark.parametrize("part", ["weights_sha256", "backend", "scene_sha256", "versions"])
def test_a_result_of_other_weights_or_backend_is_not_taken(
    stage: Stage, part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.finish(stage.begin(spec(2)))
    before = Stage.result

    def changed(job: JobSpec, **values: Any) -> dict[str, Any]:
        made = before(job, **values)
        made["provenance"][part] = {"python": "2"} if part == "versions" else "other"
        return made

    monkeypatch.setattr(Stage, "result", staticmethod(changed))
    again = stage.begin(spec(2))
    stage.finish(again)
    assert [case.reused for case in stage.campaigns.cases(again)[1]] == [False, False]


def test_a_key_belongs_to_one_request(stage: Stage) -> None:
    def create(campaign: CampaignSpec, key: str | None) -> str:
        return stage.campaigns.submit(campaign, key).id

    first = create(spec(1), "k")
    assert create(spec(1), "k") == first
    found = stage.campaigns.of_key(Key("k", digest(spec(1))))
    assert found is not None
    assert found.id == first
    with pytest.raises(KeyReused):
        create(spec(2), "k")
    assert create(spec(1), None) != first
    bobs = [stage.campaigns.submit(spec(n), "k", "bob").id for n in (2, 2)]
    assert bobs[0] == bobs[1] != first


def test_a_campaign_that_is_no_request_any_more_waits_until_it_is_one(stage: Stage, engine: Engine) -> None:
    campaign = stage.begin(spec(1))
    request = stage.campaign(campaign).spec
    changed = deepcopy(request)
    changed["grids"][0]["attacks"][0]["attack"]["method"] = "gone"

    def write(values: dict[str, Any]) -> None:
        with engine.execution_options(writes=True).begin() as connection:
            connection.execute(update(Campaign).values(spec=values))

    write(changed)
    stage.feeder.tick()
    assert stage.state(campaign) is CampaignState.PAUSED
    assert "gone" in (stage.campaign(campaign).failure or "")
    write(request)
    stage.campaigns.resume(campaign)
    stage.feeder.tick()
    assert stage.state(campaign) in (CampaignState.SELECTING, CampaignState.RUNNING)
    assert stage.campaign(campaign).failure is None


def test_unknown_campaigns_are_none(stage: Stage) -> None:
    for look in (stage.campaigns.get, stage.campaigns.pause, stage.campaigns.resume, stage.campaigns.cancel):
        assert look("none") is None  # type: ignore[operator]


def test_with_one_place_on_the_queue_campaigns_take_turns(engine: Engine, stage: Stage) -> None:
    both = [stage.begin(spec(3)), stage.begin(spec(3, seed=1))]
    stage.feeder = Feeder(Database(engine), 1)
    served = []
    while not all(stage.state(one).terminal for one in both):
        stage.feeder.tick()
        for job in stage.queued():
            served.append(job.campaign_id)
            stage.work(job)
    assert served == both * 4  # one selection job and three attacks each
