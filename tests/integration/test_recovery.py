"""Nothing that dies takes a job with it."""

import signal
from contextlib import closing
from pathlib import Path
from sqlite3 import connect

import psutil
import pytest

from services.jobs.leases import MAX_ATTEMPTS
from tests.integration.conftest import PATIENCE, Stack, end, serving, until
from tests.integration.specs import ENDLESS, QUICK, long
from tests.integration.test_jobs import perturbation

pytestmark = pytest.mark.integration

STEPS = 150
"""A few seconds of steps: time for a checkpoint, and to be killed in the middle."""

DEADLY = """
import os, signal
from typing import Literal
from services.attacks.attack import register
from services.attacks.fgsm import Fgsm

@register
class Deadly(Fgsm):
    method: Literal["deadly"] = "deadly"

    def step(self, problem, state, evaluation):
        os.kill(os.getpid(), signal.SIGKILL)
"""
"""An attack that kills its process at its first step."""


@pytest.fixture(scope="module")
def undisturbed(stack: Stack) -> str:
    """The hash of the perturbation of a job that nothing happened to."""
    return perturbation(stack, stack.submit(long(STEPS)))


def checkpoint(stack: Stack, job_id: str) -> Path:
    """The job's checkpoint, once there is one."""
    path = stack.data / "checkpoints" / job_id
    until(path.exists, "a checkpoint")
    return path


@pytest.mark.parametrize("module", ["worker.job_process", "worker.rq_worker"])
def test_a_killed_process_does_not_lose_its_job(stack: Stack, undisturbed: str, module: str) -> None:
    job_id = stack.submit(long(STEPS))
    checkpoint(stack, job_id)
    worker, runner = stack.one("worker.rq_worker"), stack.one("worker.job_process")
    killed = stack.one(module)
    killed.kill()
    job = stack.ended(job_id)
    assert (job["state"], job["attempt"]) == ("succeeded", 2)
    assert perturbation(stack, job_id) == undisturbed
    # It went on from its checkpoint: the trace was not begun again.
    assert [row["step"] for row in job["result"]["trace"]] == sorted({row["step"] for row in job["result"]["trace"]})
    assert not runner.is_running() or runner.status() == psutil.STATUS_ZOMBIE  # until its new parent asks for it
    assert worker.is_running() == (module == "worker.job_process")
    assert len(stack.processes("worker.rq_worker")) == len(stack.processes("worker.job_process")) == 1


def test_a_job_that_kills_its_process_every_time_fails_by_name(tmp_path: Path) -> None:
    (tmp_path / "deadly.py").write_text(DEADLY)
    deadly = QUICK | {"attack": QUICK["attack"] | {"method": "deadly"}}
    with serving(tmp_path / "data", SCENE_ATTACK_EXTENSIONS=str(tmp_path / "deadly.py")) as stack:
        job_id = stack.submit(deadly)
        with closing(connect(stack.data / "jobs.sqlite")) as record, record:  # it has died before, and further on
            record.execute("UPDATE jobs SET lost = ?, furthest = ?", (MAX_ATTEMPTS - 2, 1 << 40))
        job = stack.ended(job_id)
        assert (job["state"], job["failure"]["kind"], job["attempt"]) == ("failed", "worker-lost", 2)
        assert stack.ended(stack.submit(QUICK))["state"] == "succeeded"


def test_a_job_that_gets_further_each_time_may_lose_its_process_often(stack: Stack, undisturbed: str) -> None:
    job_id = stack.submit(long(STEPS))
    for _ in range(7):
        checkpoint(stack, job_id)
        saved = stack.attacking(job_id)["progress"]["step"]
        if saved > STEPS * 0.8:
            break
        stack.attacking(job_id, saved + 1)
        stack.one("worker.job_process").kill()
        until(lambda: stack.job(job_id)["state"] == "running", "the next attempt")
    assert stack.ended(job_id)["state"] == "succeeded"
    assert perturbation(stack, job_id) == undisturbed


def test_redis_may_be_lost_with_all_it_held(stack: Stack) -> None:
    running = stack.submit(long(STEPS // 3))
    stack.attacking(running)
    queued = stack.submit(QUICK)
    (redis,) = [p for p in psutil.Process(stack.process.pid).children() if p.name() == "redis-server"]
    redis.kill()
    late = stack.submit(QUICK)  # taken whether Redis is there or not
    for job_id in (running, queued, late):
        assert stack.ended(job_id)["state"] == "succeeded"
    stack.ready()


def test_the_api_may_be_killed(stack: Stack) -> None:
    job_id = stack.submit(QUICK)
    api = stack.one("api.main")
    api.kill()
    api.wait(PATIENCE)
    # The supervisor kept the socket: this waits for the new API instead of failing.
    assert stack.ended(job_id)["state"] == "succeeded"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_restarted_service_finishes_what_was_running(
    stack: Stack, undisturbed: str, number: signal.Signals, tmp_path: Path
) -> None:
    del stack  # it has made `undisturbed`
    with serving(tmp_path / "data") as first:
        running = first.submit(long(STEPS))
        checkpoint(first, running)
        queued = first.submit(QUICK)
        end(first.process, number)
    with serving(tmp_path / "data") as second:
        job = second.ended(running)
        assert (job["state"], job["attempt"]) == ("succeeded", 2)
        assert perturbation(second, running) == undisturbed
        assert second.ended(queued)["state"] == "succeeded"


def test_two_workers_run_two_jobs_and_one_each(tmp_path: Path) -> None:
    with serving(tmp_path / "data", SCENE_ATTACK_WORKERS="2", SCENE_ATTACK_JOB_SECONDS="20") as stack:
        until(lambda: len(stack.processes("worker.job_process")) == 2, "two job processes")
        first, second = stack.submit(ENDLESS), stack.submit(ENDLESS)
        stack.attacking(first)
        stack.attacking(second)
        stack.client.post(f"/v1/jobs/{first}/cancel")
        assert stack.ended(first)["state"] == "cancelled"
        job = stack.ended(second)
        assert (job["state"], job["failure"]["kind"], job["attempt"]) == ("failed", "timeout", 1)
        assert stack.ended(stack.submit(QUICK))["state"] == "succeeded"
