"""What a renderer owes an attack is checked when it is built, before anything is queued."""

from collections.abc import Callable, Iterator, Mapping

import pytest
import torch
from torch import Tensor

from scene_attack.errors import JobFailure
from scene_attack.rendering.declaration import RENDERERS, BuildRequest, Declaration, DeclaredRenderer, Group, register
from scene_attack.rendering.factory import build
from scene_attack.rendering.plan import Plan

FOG = Declaration(
    name="fog",
    groups=(Group(name="fog", shape=("3",), unit="1/m", words="fog"),),
    differentiable=True,
    method="fgsm",
)
Bounds = Mapping[str, tuple[Tensor, Tensor]]


class FogRenderer(DeclaredRenderer):
    """A renderer with nothing wrong; the cases below each break one part of it."""

    start: Callable[[], dict[str, Tensor]]
    limits: Callable[[], Bounds]

    def __init__(self) -> None:
        self.size, self.backend = (2, 2), "fog"
        self.plan = Plan.of("fog", ("fog",), (2, 2), "exact", [])

    @classmethod
    def build(cls, request: BuildRequest) -> "FogRenderer":  # noqa: ARG003 - the protocol's
        return cls()

    def initial(self) -> dict[str, Tensor]:
        return type(self).start()

    def bounds(self) -> Bounds:
        return type(self).limits()

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        return torch.zeros(1, 2, 2, 3)

    def exact(self) -> "FogRenderer":
        return self


@pytest.fixture
def fog(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[FogRenderer]]:
    before = RENDERERS.snapshot()
    monkeypatch.setattr(FogRenderer, "start", lambda: {"fog": torch.full((3,), 0.5)}, raising=False)
    monkeypatch.setattr(FogRenderer, "limits", lambda: {"fog": (torch.zeros(()), torch.ones(3))}, raising=False)
    register(FOG)(FogRenderer)
    yield FogRenderer
    RENDERERS.restore(before)


def raising(*_: object) -> object:
    raise RuntimeError("no lens")


def limits(low: float | list[float], high: float) -> Callable[[], Bounds]:
    return lambda: {"fog": (torch.tensor(low), torch.tensor(high))}


BROKEN: dict[str, tuple[str, object, str]] = {
    "build raises": ("build", raising, "renderer 'fog' raised RuntimeError: no lens"),
    "initial raises": ("start", raising, "renderer 'fog' raised RuntimeError: no lens"),
    "no group": ("start", dict, "declares groups of {'fog': 1} axes and has {}"),
    "two axes": ("start", lambda: {"fog": torch.ones(3, 1)}, "and has {'fog': 2}"),
    "no value": ("start", lambda: {"fog": torch.ones(0)}, "no finite floating-point numbers, or with none"),
    "NaN": ("start", lambda: {"fog": torch.full((3,), torch.nan)}, "no finite floating-point numbers"),
    "whole numbers": ("start", lambda: {"fog": torch.ones(3).long()}, "no finite floating-point numbers"),
    "no bounds": ("limits", dict, "gives no bounds of group 'fog'"),
    "bounds reversed": ("limits", limits(1.0, 0.0), "not a lower and an upper one"),
    "bounds NaN": ("limits", limits(torch.nan, 1.0), "not a lower and an upper one"),
    "bounds of another shape": ("limits", limits([0.0] * 5, 1.0), "renderer 'fog' raised RuntimeError"),
    "outside its bounds": ("limits", limits(0.6, 1.0), "starts with values of group 'fog' that are outside its bounds"),
}


def test_a_renderer_that_keeps_to_the_protocol_is_built(fog: type[FogRenderer]) -> None:
    assert isinstance(build(None, "fog"), fog)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", BROKEN)
def test_a_renderer_that_does_not(name: str, fog: type[FogRenderer], monkeypatch: pytest.MonkeyPatch) -> None:
    part, change, words = BROKEN[name]
    monkeypatch.setattr(fog, part, change)
    with pytest.raises(JobFailure) as failed:
        build(None, "fog")  # type: ignore[arg-type]
    assert words in str(failed.value)
    assert "fog" in str(failed.value)


def test_a_renderer_without_a_size(fog: type[FogRenderer], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fog, "__init__", lambda _: None)
    with pytest.raises(JobFailure, match="renderer 'fog' has no size and no plan and no backend"):
        build(None, "fog")  # type: ignore[arg-type]
