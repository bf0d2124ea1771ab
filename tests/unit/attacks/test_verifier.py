"""The verifier judges the exact renderer's image, as it would be saved."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import SEEDS, Verifier
from tests.unit.attacks.small import LinearRenderer


@dataclass
class Level(LinearRenderer):
    """An image of one value everywhere, whatever the parameters; its exact renderer has another one."""

    value: float = 0.0
    twin: "Level | None" = None

    def render(self, parameters: dict[str, Tensor]) -> Tensor:
        return torch.full((len(next(iter(parameters.values()))), 4, 5, 3), self.value, dtype=torch.float64)

    def exact(self) -> "Level":
        return self.twin or self


@dataclass
class Threshold:
    """Answers "above" if the image's mean is above a value, else "below"; it remembers the images."""

    above: float
    name = "threshold"
    labels = ("below", "above")
    seen: list[Tensor] = field(default_factory=list)

    def logits(self, images: Tensor) -> Tensor:
        self.seen.append(images)
        change = images.double().mean(dim=(1, 2, 3)) - self.above
        return torch.stack([-change, change], dim=-1)


LEAVE = ResolvedGoal((0,), None)
NOTHING = {"a": torch.zeros(2, 3), "b": torch.zeros(3)}


def test_an_image_that_fools_only_before_it_is_rounded_does_not_fool() -> None:
    """100.4/255 is above 100.2/255, and saved as 100; 100.6/255 is saved as 101."""
    target = Threshold(100.2 / 255)
    assert not Verifier(Level(value=100.4 / 255), target).fooled(NOTHING, LEAVE)
    assert Verifier(Level(value=100.6 / 255), target).fooled(NOTHING, LEAVE)
    assert [round(float(images.max()) * 255, 4) for images in target.seen] == [100, 101]


def test_the_exact_renderer_decides_and_not_the_loop_s() -> None:
    target = Threshold(0.5)
    dark, bright = Level(value=0.4), Level(value=0.6)
    assert not Verifier(Level(value=0.6, twin=dark), target).fooled(NOTHING, LEAVE)
    assert Verifier(Level(value=0.4, twin=bright), target).fooled(NOTHING, LEAVE)


@dataclass
class Grainy(Level):
    """A level with noise: under other seeds it has other values."""

    others: tuple[float, ...] = ()

    def reseeded(self, number: int) -> "Grainy":  # type: ignore[override]
        return Grainy(value=self.others[number - 1])


def test_an_image_with_noise_fools_only_under_all_seeds() -> None:
    target = Threshold(0.5)
    assert Verifier(Grainy(value=0.6, others=(0.6,) * SEEDS), target).fooled(NOTHING, LEAVE)
    assert len(target.seen) == 1 + SEEDS
    lucky = Verifier(Grainy(value=0.6, others=(0.6, 0.4) + (0.6,) * (SEEDS - 2)), target)
    assert not lucky.fooled(NOTHING, LEAVE)
    assert (lucky.counts.renders, lucky.counts.queries) == (3, 3), "the first that holds ends the look"
    assert not Verifier(Grainy(value=0.4, others=(0.6,) * SEEDS), target).fooled(NOTHING, LEAVE)
