"""The short form of the load that kills and stops the processes of a service, and its database, at random."""

from typing import Literal

import pytest

from benchmarks.chaos.load import Load, run

pytestmark = pytest.mark.integration


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_no_job_suffers_from_what_is_killed_and_stopped(database: Literal["sqlite", "postgresql"]) -> None:
    load = Load(jobs=6, workers=1, kills=6, stops=2, steps=40, stall=8, watchdog=12, pause=0.5, database=database)
    found = run(load)
    assert found["states"] == {"succeeded": 6}, found
    assert found["identical to an undisturbed run"] == 6, found
    assert found["ok"], found
    assert sum(found["faults"].values()) == 10, found  # Redis and the database are each kept away once, too
    assert any(attempts != "1" for attempts in found["attempts"]), "no fault met a job"
