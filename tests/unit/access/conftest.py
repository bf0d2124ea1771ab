import pytest
from sqlalchemy import Engine

from scene_attack_service.access.caller import OwnedAssets
from scene_attack_service.access.keys import AccessKeys
from tests.unit.jobs.conftest import Clock, clock, database, engine

__all__ = ["assets", "clock", "database", "engine", "keys"]


@pytest.fixture
def keys(engine: Engine, clock: Clock) -> AccessKeys:
    return AccessKeys(engine, clock)


@pytest.fixture
def assets(engine: Engine, clock: Clock) -> OwnedAssets:
    return OwnedAssets(engine, clock)
