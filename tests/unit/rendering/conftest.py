import pytest

from scene_attack.rendering.kernels import compiled


@pytest.fixture(params=["native", "torch"])
def kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The test holds for the compiled loops and for those in torch."""
    if request.param == "torch":
        monkeypatch.setattr(compiled, "library", lambda: None)
    else:
        assert compiled.library() is not None
    return str(request.param)
