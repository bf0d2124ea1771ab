"""The only function that a message on the queue may name. Its module has the same name in every process."""

from collections.abc import Callable

_run: Callable[[str], None] | None = None


def bind(run: Callable[[str], None]) -> None:
    """Sets the function that runs a job, given its id, in this process."""
    global _run
    _run = run


def run_job(job_id: str) -> None:
    """Runs the job with this id. RQ calls this function for a message."""
    assert _run is not None, "this process is no worker"
    _run(job_id)
