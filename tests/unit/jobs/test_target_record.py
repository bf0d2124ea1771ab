"""The record of each network, on both databases."""

from typing import Any

from sqlalchemy import Engine

from services.jobs.repository import Repository
from services.jobs.target_record import TargetRecords
from services.pipeline.outcome import outcome
from services.pipeline.result import Result
from services.pipeline.spec import parse
from tests.unit.api.dashboard_records import SPEC, result


def add(repository: Repository, target: str = "efficientnet-lite0", owner: str = "") -> str:
    spec = parse(SPEC.model_dump() | {"target": {"name": target}})
    job, _ = repository.create(spec, 99, None, lambda _: {}, owner=owner)
    assert job is not None
    return job.id


def end(repository: Repository, job_id: str, weights: str = "aa" * 32, **changed: Any) -> None:
    """The job runs to its end, with a result of these fields."""
    attempt = repository.lease(job_id, "test", 60)
    assert attempt is not None
    found = result(**changed)
    found["provenance"]["weights_sha256"] = weights
    repository.succeed(attempt, found, outcome(Result.model_validate(found)), [])


def test_a_rate_is_of_the_scenes_that_the_network_had_right(repository: Repository, engine: Engine) -> None:
    end(repository, add(repository))
    end(repository, add(repository), outcome="held", verified=False)
    end(repository, add(repository), verified=False)  # fooled in the loop only
    end(repository, add(repository), outcome="still-wrong", right_before=False)
    end(repository, add(repository), outcome="changed", right_before=None)
    end(repository, add(repository, owner="other"))
    add(repository)
    found = TargetRecords(engine).all("")["efficientnet-lite0"]
    assert (found.jobs, found.open, found.right_before, found.successes) == (6, 1, 3, 1)
    assert found.rate.rate == 1 / 3
    assert TargetRecords(engine).all(None)["efficientnet-lite0"].successes == 2


def test_the_weights_are_those_of_the_newest_job(repository: Repository, engine: Engine, clock: Any) -> None:
    for weights in ("aa" * 32, "bb" * 32):
        end(repository, add(repository), weights)
        clock.advance(1)
    add(repository, "resnet34")
    found = TargetRecords(engine).all(None)
    assert found["efficientnet-lite0"].weights_sha256 == "bb" * 32
    assert (found["resnet34"].weights_sha256, found["resnet34"].jobs) == (None, 1)
