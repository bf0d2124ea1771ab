"""Nothing that dies takes a job with it."""

import signal
from pathlib import Path

import psutil
import pytest

from tests.integration.conftest import PATIENCE, Stack, end, serving, until
from tests.integration.specs import ENDLESS, LASTING, QUICK, long

pytestmark = pytest.mark.integration


@pytest.mark.parametrize("module", ["scene_attack_worker.job_process", "scene_attack_worker.rq_worker"])
def test_a_killed_process_does_not_lose_its_job(stack: Stack, undisturbed: str, module: str) -> None:
    job_id = stack.submit(LASTING)
    stack.checkpoint(job_id)
    worker, runner = stack.one("scene_attack_worker.rq_worker"), stack.one("scene_attack_worker.job_process")
    killed = stack.one(module)
    killed.kill()
    job = stack.ended(job_id)
    assert (job["state"], job["attempt"]) == ("succeeded", 2)
    assert stack.perturbation(job_id) == undisturbed
    # It went on from its checkpoint: the trace was not begun again.
    assert [row["step"] for row in job["result"]["trace"]] == sorted({row["step"] for row in job["result"]["trace"]})
    assert not runner.is_running() or runner.status() == psutil.STATUS_ZOMBIE  # until its new parent asks for it
    assert worker.is_running() == (module == "scene_attack_worker.job_process")
    for each in ("scene_attack_worker.rq_worker", "scene_attack_worker.job_process"):
        assert len(stack.processes(each)) == 1


def test_redis_may_be_lost_with_all_it_held(stack: Stack) -> None:
    running = stack.submit(long(50))
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
    api = stack.one("scene_attack_api.main")
    api.kill()
    api.wait(PATIENCE)
    # The supervisor kept the socket: this waits for the new API instead of failing.
    assert stack.ended(job_id)["state"] == "succeeded"


def test_a_restarted_service_finishes_what_was_running(undisturbed: str, tmp_path: Path) -> None:
    """Once it was ended, and once it was killed."""
    with serving(tmp_path / "data") as first:
        interrupted = end_while_jobs_wait(first, signal.SIGTERM)
    with serving(tmp_path / "data") as second:
        finished(second, *interrupted, undisturbed)
        interrupted = end_while_jobs_wait(second, signal.SIGKILL)
    with serving(tmp_path / "data") as third:
        finished(third, *interrupted, undisturbed)


def end_while_jobs_wait(stack: Stack, number: signal.Signals) -> tuple[str, str]:
    """Ends the service by a signal. Returns the ids of the job that was running, and of a queued one."""
    running = stack.submit(LASTING)
    stack.checkpoint(running)
    queued = stack.submit(QUICK)
    end(stack.process, number)
    return running, queued


def finished(stack: Stack, running: str, queued: str, undisturbed: str) -> None:
    job = stack.ended(running)
    assert (job["state"], job["attempt"]) == ("succeeded", 2)
    assert stack.perturbation(running) == undisturbed
    assert stack.ended(queued)["state"] == "succeeded"


def test_two_workers_run_two_jobs_and_one_each(tmp_path: Path) -> None:
    with serving(tmp_path / "data", SCENE_ATTACK_WORKERS="2", SCENE_ATTACK_JOB_SECONDS="20") as stack:
        until(lambda: len(stack.processes("scene_attack_worker.job_process")) == 2, "two job processes")
        first, second = stack.submit(ENDLESS), stack.submit(ENDLESS)
        stack.attacking(first)
        stack.attacking(second)
        stack.client.post(f"/v1/jobs/{first}/cancel")
        assert stack.ended(first)["state"] == "cancelled"
        job = stack.ended(second)
        assert (job["state"], job["failure"]["kind"], job["attempt"]) == ("failed", "timeout", 1)
        assert stack.ended(stack.submit(QUICK))["state"] == "succeeded"
