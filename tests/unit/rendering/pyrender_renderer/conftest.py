import pytest

from services.rendering.kernels import compiled
from services.rendering.opengl import context


@pytest.fixture
def software_opengl() -> None:
    """The kernels are built and OpenGL runs in software, so that the rasteriser may draw."""
    assert compiled.library() is not None
    assert context.current().software
