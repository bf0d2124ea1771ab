from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import Engine

from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings


class Clock:
    def __init__(self) -> None:
        self.now = datetime(2030, 1, 1, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += timedelta(seconds=seconds)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    """Settings with a database that has the tables and no rows: each of the two kinds in turn."""
    if request.param == "postgresql":
        return Settings(data=tmp_path, database_url=request.getfixturevalue("postgresql_url"))
    settings = Settings(data=tmp_path)
    engine = connect(settings)
    migrate(engine, settings)
    engine.dispose()
    return settings


@pytest.fixture
def engine(database: Settings) -> Iterator[Engine]:
    engine = connect(database)
    yield engine
    engine.dispose()


@pytest.fixture
def record(engine: Engine, clock: Clock) -> Record:
    return Record(engine, clock)
