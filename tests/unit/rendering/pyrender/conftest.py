import pytest

from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl import context


@pytest.fixture
def software_opengl() -> None:
    """The kernels are built and OpenGL runs in software, so that the rasteriser may draw."""
    assert compiled.library() is not None
    assert context.current().software
