"""A job whose renderer has noise: the verdict is on the exact image under other seeds, too."""

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

import scene_attack as sa
from scene_attack.attacks.run import SEEDS
from scene_attack.rendering.declaration import RENDERERS, BuildRequest, Declaration, DeclaredRenderer, Group, register
from scene_attack.rendering.plan import Plan
from scene_attack.runs.analyse import NO_ADVERSARY
from scene_attack.runs.result import Result, success

SCENE = {"camera": {"size": [64, 64]}, "objects": [{"mesh": "primitive/sphere"}]}
NOISE = 0.02
"""Standard deviation of a value of the image."""


class Grain(DeclaredRenderer):
    """A sheet of one grey with noise of a seed; by `spoilt` seeds it is as bright as at the start."""

    spoilt: frozenset[int] = frozenset()
    backend = "grain"
    plan = property(lambda self: Plan.of(self.name, self.groups, self.size, "exact", []))

    def __init__(self, size: tuple[int, int], seed: int = 0) -> None:
        self.size, self._seed = size, seed

    @classmethod
    def build(cls, request: BuildRequest) -> "Grain":
        return cls(request.scene.description.camera.size)

    def initial(self) -> dict[str, Tensor]:
        return {"grey": torch.zeros(1)}

    def bounds(self) -> dict[str, tuple[Tensor, Tensor]]:
        return {"grey": (torch.tensor(0.0), torch.tensor(0.5))}

    def render(self, parameters: Any) -> Tensor:
        level = 0.2 + parameters["grey"][:, None, None, :] * (self._seed not in self.spoilt)
        noise = torch.randn(*self.size, 3, generator=torch.Generator().manual_seed(self._seed))
        return (level + NOISE * noise).clamp(0, 1)

    def exact(self) -> "Grain":
        return self

    def reseeded(self, number: int) -> "Grain":
        return Grain(self.size, number)


@pytest.fixture(autouse=True)
def grain() -> Iterator[None]:
    before = RENDERERS.snapshot()
    grey = Group(name="grey", shape=("1",), unit="displayed value", words="grey", suggested_step=0.1)
    declared = Declaration(name="grain", groups=(grey,), differentiable=False, method="zoo")
    register(declared)(Grain)
    yield
    RENDERERS.restore(before)


def run(**analysis: Any) -> Result:
    """Attacks a network that answers 1 where the image is brighter than 0.35: only some way from its 0.2."""
    target = sa.target(lambda images: images.mean((2, 3))[:, :2] * torch.tensor([0, 1]) + torch.tensor([0.35, 0]))
    settings: dict[str, Any] = {"delta": 0.1, "learning_rate": 0.1, "weight": 0.0, "steps": 8}
    return sa.attack(
        sa.renderer(SCENE, "grain"), target, sa.ZOO(renderer="grain", **settings), analysis=analysis
    ).record


def test_the_result_says_how_the_verdict_holds_under_other_seeds() -> None:
    result = run()
    assert (result.outcome, result.verified, result.verdict.stopped) == ("changed", True, "verified")
    noise = result.verdict.noise
    assert noise is not None
    assert (noise.seeds, noise.share) == (SEEDS, 1.0)
    # of the noise's own deviation: SEEDS − 1 degrees of freedom at each of thousands of values leave it under 2 % off
    assert noise.standard_error == pytest.approx(NOISE, rel=0.02)
    assert any(f"{SEEDS} other seeds" in sentence for sentence in result.findings)


def test_one_seed_that_holds_refuses_what_all_others_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Grain, "spoilt", frozenset([SEEDS]))
    result = run()
    assert (result.outcome, result.verified, result.verdict.fooled) == ("held", False, True)
    assert result.verdict.noise is not None
    assert result.verdict.noise.share == 1 - 1 / SEEDS
    assert not success(result)


@pytest.mark.parametrize("spoilt", [0, SEEDS])
def test_what_is_of_verified_adversaries_is_made_of_those_that_hold_under_every_seed(
    monkeypatch: pytest.MonkeyPatch, spoilt: int
) -> None:
    monkeypatch.setattr(Grain, "spoilt", frozenset([spoilt] if spoilt else []))
    result = run(survival={"draws": 2})
    assert (result.analyses.survival is None) == bool(spoilt)
    assert (NO_ADVERSARY in result.warnings) == bool(spoilt)
