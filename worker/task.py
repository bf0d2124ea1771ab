"""The one function a message on the queue may name, in a module that is imported under the same name everywhere."""

from collections.abc import Callable

_run: Callable[[str], None] | None = None


def bind(run: Callable[[str], None]) -> None:
    """Say what runs a job in this process."""
    global _run
    _run = run


def run_job(job_id: str) -> None:
    """What a message asks for: run this job."""
    assert _run is not None, "this process is no worker"
    _run(job_id)
