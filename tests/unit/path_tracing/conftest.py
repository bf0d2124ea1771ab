import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.declaration import RENDERERS


def missing(name: str) -> str | None:
    """Why a path tracer cannot be tested here; None if it can."""
    if name not in RENDERERS:
        return f"the plug-in of {name} is not installed"
    requires = RENDERERS[name].requires
    try:
        if requires is not None:
            requires("attack.renderer")
    except InvalidRequest as error:
        return error.detail
    return None


@pytest.fixture(params=["blender", "mitsuba"])
def name(request: pytest.FixtureRequest) -> str:
    """The name of each path tracer that is installed."""
    if why := missing(request.param):
        pytest.skip(why)
    return str(request.param)
