import pytest
from sqlalchemy import Engine

from services.access.keys import AccessKeys
from tests.unit.jobs.conftest import Clock, clock, database, engine

__all__ = ["clock", "database", "engine", "keys"]


@pytest.fixture
def keys(engine: Engine, clock: Clock) -> AccessKeys:
    return AccessKeys(engine, clock)
