"""The record of each network, on both databases."""

from typing import Any

from sqlalchemy import Engine

from services.jobs.database import Database
from services.jobs.record import Record
from services.jobs.statistics import TargetRecords
from services.pipeline.result import Result, outcome
from services.pipeline.spec import parse
from tests.unit.api.dashboard_records import SPEC, result


def add(record: Record, target: str = "efficientnet-lite0", owner: str = "") -> str:
    spec = parse(SPEC.model_dump() | {"target": {"name": target}})
    job, _ = record.jobs.create(spec, 99, None, lambda _: {}, owner=owner)
    assert job is not None
    return job.id


def end(record: Record, job_id: str, weights: str = "aa" * 32, **changed: Any) -> None:
    """The job runs to its end, with a result of these fields."""
    attempt = record.leases.lease(job_id, "test", 60)
    assert attempt is not None
    found = result(**changed)
    found["provenance"]["weights_sha256"] = weights
    record.leases.succeed(attempt, found, outcome(Result.model_validate(found)), [])


def test_a_rate_is_of_the_scenes_that_the_network_had_right(record: Record, engine: Engine) -> None:
    end(record, add(record))
    end(record, add(record), outcome="held", verified=False)
    end(record, add(record), verified=False)  # fooled in the loop only
    end(record, add(record), outcome="still-wrong", right_before=False)
    end(record, add(record), outcome="changed", right_before=None)
    end(record, add(record, owner="other"))
    add(record)
    found = TargetRecords(Database(engine)).all("")["efficientnet-lite0"]
    assert (found.jobs, found.open, found.right_before, found.successes) == (6, 1, 3, 1)
    assert found.rate.rate == 1 / 3
    assert TargetRecords(Database(engine)).all(None)["efficientnet-lite0"].successes == 2


def test_the_weights_are_those_of_the_newest_job(record: Record, engine: Engine, clock: Any) -> None:
    for weights in ("aa" * 32, "bb" * 32):
        end(record, add(record), weights)
        clock.advance(1)
    add(record, "resnet34")
    found = TargetRecords(Database(engine)).all(None)
    assert found["efficientnet-lite0"].weights_sha256 == "bb" * 32
    assert (found["resnet34"].weights_sha256, found["resnet34"].jobs) == (None, 1)
