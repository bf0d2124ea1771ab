import os
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import Engine
from sqlalchemy.orm import Session

from services.errors import InUse
from services.jobs.artifacts import ArtifactStore
from services.jobs.deletion import Deletions
from services.jobs.housekeeping import GRACE_SECONDS, Housekeeping, remove_unfinished
from services.jobs.models import Artifact, Campaign, CampaignJob, CampaignState, Job
from services.jobs.repository import Repository
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import OUTCOME, add, attacks, start

pytestmark = pytest.mark.slow

DAY = 24 * 3600.0


@pytest.fixture
def store(tmp_path: Path) -> ArtifactStore:
    return ArtifactStore(tmp_path)


@pytest.fixture
def deletions(engine: Engine, clock: Clock) -> Deletions:
    return Deletions(engine, clock)


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


def finish(repository: Repository, job: Job, *hashes: str) -> None:
    files = [
        Artifact(job_id=job.id, name=f"{n}.png", sha256=sha256, media_type="image/png", size=1)
        for n, sha256 in enumerate(hashes)
    ]
    assert repository.succeed(start(repository, job), {}, OUTCOME, files)


def test_a_job_goes_with_its_files_and_not_with_those_of_others(
    repository: Repository, engine: Engine, store: ArtifactStore, tmp_path: Path
) -> None:
    first, second = add(repository), add(repository)
    shared, own = put(store, tmp_path, b"shared"), put(store, tmp_path, b"own")
    finish(repository, first, shared, own)
    finish(repository, second, shared)
    house = Housekeeping(engine, store, tmp_path)
    house.delete(first.id)
    assert repository.get(first.id) is None
    assert repository.events(first.id, 0) == []
    assert store.names() == [shared]
    house.delete(first.id)  # again: nothing happens
    house.delete(second.id)
    assert store.names() == []


def test_a_file_that_was_put_just_now_stays(
    repository: Repository, engine: Engine, store: ArtifactStore, tmp_path: Path
) -> None:
    job = add(repository)
    young = put(store, tmp_path, b"young", old=False)
    finish(repository, job, young)
    old = put(store, tmp_path, b"old")
    put(store, tmp_path, b"old", old=False)  # another job is about to name it
    house = Housekeeping(engine, store, tmp_path)
    house.delete(job.id)
    house.tidy()
    assert set(store.names()) == {young, old}


def test_a_search_finds_files_that_no_job_names_and_half_written_ones(
    repository: Repository, engine: Engine, store: ArtifactStore, tmp_path: Path
) -> None:
    job = add(repository)
    named, unnamed = put(store, tmp_path, b"named"), put(store, tmp_path, b"unnamed")
    finish(repository, job, named)
    parts = [path(tmp_path, unnamed).with_suffix(".00.part"), path(tmp_path, named).with_suffix(".11.part")]
    for part in parts:
        part.write_bytes(b"half")
    os.utime(parts[0], (0, 0))
    Housekeeping(engine, store, tmp_path).tidy()
    assert store.names() == [named]
    assert [part.exists() for part in parts] == [False, True]
    remove_unfinished(tmp_path / "there is no such folder")


def test_a_job_in_use_is_not_deleted(repository: Repository, engine: Engine, deletions: Deletions) -> None:
    job = add(repository)
    with pytest.raises(InUse, match="queued"):
        deletions.delete(job.id)
    attempt = start(repository, job)
    with pytest.raises(InUse, match="running"):
        deletions.delete(job.id)
    repository.fail(attempt, "internal", "because")
    refer(engine, job)
    with pytest.raises(InUse, match="the campaign c refers"):
        deletions.delete(job.id)
    assert repository.get(job.id) is not None
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
    repository: Repository, engine: Engine, deletions: Deletions, clock: Clock, ended: bool
) -> None:
    old, of_campaign, running = add(repository), add(repository), add(repository)
    finish(repository, old, "aa" * 32)
    finish(repository, of_campaign, "bb" * 32)
    refer(engine, of_campaign, ended=ended)
    start(repository, running, seconds=100 * DAY)
    clock.advance(2 * DAY)
    young = add(repository)
    finish(repository, young, "cc" * 32)
    assert deletions.expire(3) == []
    gone = {"aa" * 32, "bb" * 32} if ended else {"aa" * 32}
    assert set(deletions.expire(1)) == gone
    kept = {running.id, young.id} | (set() if ended else {of_campaign.id})
    assert {job.id for job in attacks(repository)} == kept
    assert deletions.unnamed(["aa" * 32, "cc" * 32]) == {"aa" * 32}
