"""The short form of the load that kills and stops the processes of a service at random."""

import pytest

from benchmarks.chaos.load import Load, run

pytestmark = pytest.mark.integration


def test_no_job_suffers_from_what_is_killed_and_stopped() -> None:
    found = run(Load(jobs=6, workers=1, kills=6, stops=2, stall=4, watchdog=8, pause=1))
    assert found["states"] == {"succeeded": 6}, found
    assert found["identical to an undisturbed run"] == 6, found
    assert found["ok"], found
    assert sum(found["faults"].values()) == 9, found  # Redis is kept away once, too
    assert any(attempts != "1" for attempts in found["attempts"]), "no fault met a job"
