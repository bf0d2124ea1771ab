from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import Engine

from services.jobs.database import connect, migrate
from services.jobs.repository import Repository
from services.settings import Settings


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


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    settings = Settings(data=tmp_path)
    engine = connect(settings)
    migrate(engine, settings)
    yield engine
    engine.dispose()


@pytest.fixture
def repository(engine: Engine, clock: Clock) -> Repository:
    return Repository(engine, clock)
