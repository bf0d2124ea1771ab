from collections.abc import Iterator

import pytest

from scene_attack_blender.process import BlenderProcess, blender
from tests.unit.path_tracing.conftest import missing


@pytest.fixture
def process() -> Iterator[BlenderProcess]:
    """This process's Blender, not yet started."""
    if why := missing("blender"):
        pytest.skip(why)
    blender().close()
    yield blender()
    blender().close()
