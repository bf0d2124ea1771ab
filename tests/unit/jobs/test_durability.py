"""What must outlast a power cut is on the disk when a client hears of it; all else may be made again."""

from pathlib import Path

import pytest
from sqlalchemy import Connection, event

from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.unit.jobs.records import add, start

NORMAL, FULL = 1, 2
"""SQLite's levels of `synchronous`: FULL waits for the disk at each commit."""


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(data=tmp_path)


def test_a_submission_waits_for_the_disk_and_progress_does_not(settings: Settings) -> None:
    engine = connect(settings)
    migrate(engine, settings)
    record = Record(engine)
    levels: list[int] = []

    def note(connection: Connection) -> None:
        levels.append(int(connection.exec_driver_sql("PRAGMA synchronous").scalar_one()))

    event.listen(engine, "commit", note)
    job = add(record)
    assert levels == [FULL]
    attempt = start(record, job)
    levels.clear()
    record.leases.progress(attempt, "attacking", 1, 9, [])
    assert levels == [NORMAL]
    engine.dispose()
