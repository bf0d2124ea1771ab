"""The worker's watch over its job process, which here only answers what it was sent."""

from pathlib import Path

import pytest

from services.jobs.child import Child
from services.jobs.database import connect, migrate
from services.jobs.placement import Abilities
from services.jobs.repository import Repository
from services.settings import Settings
from tests.unit.jobs.records import add, state
from worker.runner import Runner


class Hanging(Runner):
    """A runner whose job process hangs in its job."""

    child: Child

    def ensure_ready(self) -> None:
        child = self.child = self._child = Child("tests.unit.jobs.echo_child", self._settings)
        child.receive(30)
        child.send({"do": "hang"})
        self._abilities = Abilities("cpu", frozenset({"efficientnet-lite0"}), 2**34)


def test_a_job_process_ends_with_the_watch_over_it(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, lease_seconds=0.04)
    engine = connect(settings)
    migrate(engine, settings)
    repository = Repository(engine)
    job = add(repository)
    runner = Hanging(settings, repository, "w")

    def beat() -> None:
        raise ValueError("a fault of the worker's own")

    with pytest.raises(ValueError, match="own"):
        runner.run(job.id, beat)
    assert not runner.child.alive()
    assert state(repository, job.id) == "running"  # until its lease lapses
    engine.dispose()
