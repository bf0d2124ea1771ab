"""Nothing that hangs holds a job up for ever: it is killed, and the job goes on from its checkpoint."""

import signal
from collections.abc import Iterator

import httpx
import psutil
import pytest

from tests.integration.conftest import Stack, serving, until
from tests.integration.specs import LASTING, QUICK

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def impatient(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with serving(tmp_path_factory.mktemp("hangs") / "data", SCENE_ATTACK_STALL_SECONDS="4") as stack:
        yield stack


def stop(process: psutil.Process) -> None:
    process.send_signal(signal.SIGSTOP)


def submitted(stack: Stack) -> str | None:
    """The id of a new job, or None if the API was killed while it was asked."""
    try:
        return stack.submit(QUICK)
    except httpx.TransportError:
        return None


def gone(process: psutil.Process) -> bool:
    return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE


@pytest.mark.parametrize("module", ["scene_attack_worker.job_process", "scene_attack_worker.rq_worker"])
def test_a_stopped_process_does_not_hold_its_job(impatient: Stack, undisturbed: str, module: str) -> None:
    job_id = impatient.submit(LASTING)
    impatient.checkpoint(job_id)
    stopped, runs = impatient.one(module), impatient.one("scene_attack_worker.job_process")
    stop(stopped)
    job = impatient.ended(job_id)
    assert job["state"] == "succeeded"
    # A job process whose worker is stopped goes on, and may be done before the worker is killed.
    assert job["attempt"] >= 2 or module == "scene_attack_worker.rq_worker"
    assert impatient.perturbation(job_id) == undisturbed
    until(lambda: gone(stopped) and gone(runs), "what was stopped is killed")


def test_the_rest_of_the_service_may_be_stopped_too(impatient: Stack) -> None:
    (redis,) = [p for p in psutil.Process(impatient.process.pid).children() if p.name() == "redis-server"]
    stopped = [redis, impatient.one("scene_attack_api.main"), impatient.one("scene_attack_service.jobs.warm_process")]
    for process in stopped:
        stop(process)
    job_id = until(lambda: submitted(impatient), "the API takes a job")
    impatient.ready()
    assert impatient.ended(job_id)["state"] == "succeeded"
    until(lambda: all(gone(process) for process in stopped), "what was stopped is killed")
