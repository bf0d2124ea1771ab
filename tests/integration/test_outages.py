"""What is away for a while costs no job: requests are refused by name, and jobs go on when it is back."""

import os
import sqlite3
import subprocess
from collections.abc import Iterator

import pytest

from scene_attack_service.jobs.files import RESERVE
from tests.integration.conftest import Stack, serving, until
from tests.integration.specs import ENDLESS, LASTING, QUICK
from tests.unit.jobs.test_outages import fill

pytestmark = [pytest.mark.integration, pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a disk")]


@pytest.fixture(scope="module")
def on_small_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack whose data directory is a disk of 60 MB."""
    folder = tmp_path_factory.mktemp("outages") / "data"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=60m", "tmpfs", str(folder)], check=True)
    try:
        with serving(folder) as stack:
            yield stack
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def refused(stack: Stack, resource: str) -> str | None:
    """What a refused submission says, once the service knows of the outage; None until then."""
    answer = stack.client.post("/v1/jobs", json=QUICK)
    ready = stack.client.get("/readyz").json()
    if answer.status_code != 503 or ready[resource]:
        return None
    assert answer.headers["Retry-After"] == "5"
    assert not ready["ready"]
    return str(answer.json()["detail"])


def test_a_full_disk_costs_no_job(on_small_disk: Stack, undisturbed: str) -> None:
    job_id = on_small_disk.submit(LASTING)
    on_small_disk.checkpoint(job_id)
    file = fill(on_small_disk.data)
    assert "the disk of the data directory is full" in until(lambda: refused(on_small_disk, "storage"), "a refusal")
    until(lambda: "attempt ended by an outage" in on_small_disk.log.read_text(), "the job meets the full disk")
    file.unlink()
    assert on_small_disk.ended(job_id)["state"] == "succeeded"
    assert on_small_disk.perturbation(job_id) == undisturbed
    assert not list(on_small_disk.data.rglob("*.part"))


@pytest.mark.parametrize("met", [False, True], ids=["as the disk fills", "once its attempt has ended"])
def test_a_running_job_is_cancelled_although_the_disk_is_full(on_small_disk: Stack, met: bool) -> None:
    until((on_small_disk.data / RESERVE).exists, "space is set aside")
    before = on_small_disk.log.read_text().count("attempt ended by an outage")
    job_id = on_small_disk.submit(ENDLESS)
    on_small_disk.checkpoint(job_id)
    file = fill(on_small_disk.data)
    if met:
        until(lambda: on_small_disk.log.read_text().count("attempt ended by an outage") > before, "it meets the disk")
    answer = on_small_disk.client.post(f"/v1/jobs/{job_id}/cancel")
    assert answer.status_code == 202, answer.text
    assert on_small_disk.ended(job_id)["state"] == "cancelled"
    file.unlink()


def test_a_database_that_is_away_costs_no_job(on_small_disk: Stack) -> None:
    data = on_small_disk.data
    before = on_small_disk.log.read_text().count("attempt ended by an outage")
    job_id = on_small_disk.submit(LASTING)
    on_small_disk.checkpoint(job_id)
    with sqlite3.connect(data / "jobs.sqlite", timeout=60) as other:
        other.execute("BEGIN IMMEDIATE")
        answer = on_small_disk.client.post("/v1/jobs", json=QUICK)
        assert (answer.status_code, answer.headers["Retry-After"]) == (503, "5")
        assert "database" in answer.json()["detail"]
        until(lambda: on_small_disk.log.read_text().count("attempt ended by an outage") > before, "it meets the lock")
        other.rollback()
    assert on_small_disk.ended(job_id)["state"] == "succeeded"
    other.close()
