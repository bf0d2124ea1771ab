import os
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import Engine
from sqlalchemy.orm import Session

from scene_attack.errors import InUse
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.files import (
    GRACE_SECONDS,
    ArtifactStore,
    Housekeeping,
    delete_with_files,
    remove_unfinished,
)
from scene_attack_service.jobs.jobs import Jobs
from scene_attack_service.jobs.models import Artifact, Campaign, CampaignJob, CampaignState, Job
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import OUTCOME, add, attacks, start

pytestmark = pytest.mark.slow

DAY = 24 * 3600.0


@pytest.fixture
def store(tmp_path: Path) -> ArtifactStore:
    return ArtifactStore(tmp_path)


@pytest.fixture
def deletions(engine: Engine, clock: Clock) -> Jobs:
    return Jobs(Database(engine, clock))


def settings(folder: Path) -> Settings:
    return Settings(data=folder, cache=folder / "cache")


def put(store: ArtifactStore, folder: Path, data: bytes, *, old: bool = True) -> str:
    """Stores bytes, as if it had been long ago, and returns their hash."""
    file = folder / "file"
    file.write_bytes(data)
    sha256 = store.put(file).sha256
    if old:
        long_ago = time.time() - 2 * GRACE_SECONDS
        os.utime(path(folder, sha256), (long_ago, long_ago))
    return sha256


def path(folder: Path, sha256: str) -> Path:
    return folder / "artifacts" / sha256[:2] / sha256


def finish(record: Record, job: Job, *hashes: str) -> None:
    files = [
        Artifact(job_id=job.id, name=f"{n}.png", sha256=sha256, media_type="image/png", size=1)
        for n, sha256 in enumerate(hashes)
    ]
    assert record.leases.succeed(start(record, job), {}, OUTCOME, files)


def test_a_job_goes_with_its_files_and_not_with_those_of_others(
    record: Record, store: ArtifactStore, tmp_path: Path
) -> None:
    first, second = add(record), add(record)
    shared, own = put(store, tmp_path, b"shared"), put(store, tmp_path, b"own")
    finish(record, first, shared, own)
    finish(record, second, shared)
    delete_with_files(record, store, first.id)
    assert record.jobs.get(first.id) is None
    assert record.jobs.events(first.id, 0) == []
    assert store.names() == [shared]
    delete_with_files(record, store, first.id)  # again: nothing happens
    delete_with_files(record, store, second.id)
    assert store.names() == []


def test_a_file_that_was_put_just_now_stays(record: Record, store: ArtifactStore, tmp_path: Path) -> None:
    job = add(record)
    young = put(store, tmp_path, b"young", old=False)
    finish(record, job, young)
    old = put(store, tmp_path, b"old")
    put(store, tmp_path, b"old", old=False)  # another job is about to name it
    delete_with_files(record, store, job.id)
    Housekeeping(record, settings(tmp_path)).tidy()
    assert set(store.names()) == {young, old}


def test_a_search_finds_files_that_no_job_names_and_half_written_ones(
    record: Record, store: ArtifactStore, tmp_path: Path
) -> None:
    job = add(record)
    named, unnamed = put(store, tmp_path, b"named"), put(store, tmp_path, b"unnamed")
    finish(record, job, named)
    parts = [path(tmp_path, unnamed).with_suffix(".00.part"), path(tmp_path, named).with_suffix(".11.part")]
    for part in parts:
        part.write_bytes(b"half")
    os.utime(parts[0], (0, 0))
    Housekeeping(record, settings(tmp_path)).tidy()
    assert store.names() == [named]
    assert [part.exists() for part in parts] == [False, True]
    remove_unfinished(tmp_path / "there is no such folder")


def test_a_job_in_use_is_not_deleted(record: Record, engine: Engine, deletions: Jobs) -> None:
    job = add(record)
    with pytest.raises(InUse, match="queued"):
        deletions.delete(job.id)
    attempt = start(record, job)
    with pytest.raises(InUse, match="running"):
        deletions.delete(job.id)
    record.leases.fail(attempt, "internal", "because")
    refer(engine, job)
    with pytest.raises(InUse, match="the campaign c refers"):
        deletions.delete(job.id)
    assert record.jobs.get(job.id) is not None
    assert deletions.delete("no such job") == []


def refer(engine: Engine, job: Job, *, ended: bool = False) -> None:
    """Records a campaign "c" that refers to the job."""
    now = datetime(2030, 1, 1, tzinfo=UTC)
    campaign = Campaign(
        id="c",
        name="c",
        state=CampaignState.FINISHED if ended else CampaignState.RUNNING,
        spec={},
        created_at=now,
        ended_at=now if ended else None,
        view_count=1,
        request_digest="00",
    )
    planned = CampaignJob(
        campaign_id="c", number=0, target="t", attack="a", view=0, right=True, digest="00", spec={}, job_id=job.id
    )
    with Session(engine) as session, session.begin():
        session.add(campaign)
        session.flush()
        session.add(planned)


@pytest.mark.parametrize("ended", [False, True])
def test_what_is_older_than_the_operator_keeps_goes(
    record: Record, engine: Engine, deletions: Jobs, clock: Clock, ended: bool
) -> None:
    old, of_campaign, running = add(record), add(record), add(record)
    finish(record, old, "aa" * 32)
    finish(record, of_campaign, "bb" * 32)
    refer(engine, of_campaign, ended=ended)
    start(record, running, seconds=100 * DAY)
    clock.advance(2 * DAY)
    young = add(record)
    finish(record, young, "cc" * 32)
    assert deletions.expire(3) == []
    gone = {"aa" * 32, "bb" * 32} if ended else {"aa" * 32}
    assert set(deletions.expire(1)) == gone
    kept = {running.id, young.id} | (set() if ended else {of_campaign.id})
    assert {job.id for job in attacks(record)} == kept
    assert deletions.unnamed(["aa" * 32, "cc" * 32]) == {"aa" * 32}
