"""Opinions of other renderers, against images of the changed scene that are drawn in another way."""

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from scene_attack.analysis.second_opinion import second_opinion
from scene_attack.analysis.transfer import Wanted
from scene_attack.errors import JobFailure
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.declaration import RENDERERS, BuildRequest, Declaration, DeclaredRenderer, register
from scene_attack.rendering.factory import build
from scene_attack.rendering.plan import Plan
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.torch.shape import bent
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack.targets import registry
from tests.unit.jobs.small import LIBRARY

TARGET = "alexnet-furniture"


def scene(**thing: Any) -> ResolvedScene:
    objects = [{"mesh": "primitive/cube", "rotation": [0.0, 0.3, 0.0]} | thing]
    return resolve(Scene.model_validate({"objects": objects, "camera": {"size": [48, 48]}}), LIBRARY)


def image(renderer: Renderer) -> Tensor:
    return to_bytes(renderer.render({group: value[None] for group, value in renderer.initial().items()})[0])


def wanted() -> Wanted:
    return Wanted(frozenset(), None, (), 0.0)


def opinion(resolved: ResolvedScene, renderer: str, change: dict[str, Tensor], other: str) -> Any:
    return second_opinion(resolved, renderer, change, other, registry.load(TARGET), wanted())


def test_a_pose_and_a_colour_are_drawn_as_if_the_scene_were_described_with_them() -> None:
    change = {
        "color": torch.tensor([[-0.25, 0.0, -0.5]], dtype=torch.float64),
        "rotation": torch.tensor([[0.0, 0.2, 0.0]], dtype=torch.float64),
    }
    found, images = opinion(scene(), "pyrender", change, "torch")
    described = scene(color=[0.75, 1.0, 0.5], rotation=[0.0, 0.5, 0.0])
    expected = image(build(described, "torch", tolerance="exact"))
    off = (images["second_opinion_torch_attacked.png"].int() - expected.int()).abs()
    assert int(off.max()) <= 1  # the sum 0.3 + 0.2 is rounded
    assert torch.equal(images["second_opinion_torch_original.png"], image(build(scene(), "torch", tolerance="exact")))
    assert (found.renderer, found.note, found.share) == ("torch", "", None)


def test_dents_are_in_the_mesh_and_light_of_the_map_is_left_out() -> None:
    resolved = scene()
    dents = build(resolved, "torch", groups=["bump"]).initial()["bump"]
    random = torch.Generator().manual_seed(1)
    change = {"bump": 3 * torch.randn(dents.shape, generator=random), "lamp": 0.5 * torch.ones(7)}
    found, images = opinion(resolved, "torch", change, "pyrender")
    expected = image(build(bent(resolved, {"bump": change["bump"]}), "pyrender", tolerance="exact"))
    assert torch.equal(images["second_opinion_pyrender_attacked.png"], expected)
    assert not torch.equal(images["second_opinion_pyrender_original.png"], expected)
    assert found.note == "without lamp, which pyrender does not have"


class Twin(DeclaredRenderer):
    """Draws as pyrender does; seeds for which it is `blind` show nothing of a change, and it may fail."""

    blind: frozenset[int] = frozenset()
    fails = False
    backend = "twin"
    plan = property(lambda self: Plan.of(self.name, self.groups, self.size, "exact", []))

    def __init__(self, inner: Renderer, seed: int = 0) -> None:
        self._inner, self._seed, self.size = inner, seed, inner.size

    @classmethod
    def build(cls, request: BuildRequest) -> "Twin":
        return cls(build(request.scene, "pyrender", tolerance="exact"))

    def initial(self) -> dict[str, Tensor]:
        return self._inner.initial()

    def bounds(self) -> Any:
        return self._inner.bounds()

    def names(self, group: str) -> Any:
        return self._inner.names(group)

    def render(self, parameters: Any) -> Tensor:
        if self.fails:
            raise JobFailure("internal", "its process was killed twice")
        return self._inner.render({} if self._seed in self.blind else parameters)

    def exact(self) -> "Twin":
        return self

    def reseeded(self, number: int) -> "Twin":
        return type(self)(self._inner, number)


@pytest.fixture
def twin() -> Iterator[type[Twin]]:
    before = RENDERERS.snapshot()
    declared = Declaration(name="twin", groups=PYRENDER.groups, differentiable=False, method="zoo")
    yield register(declared)(type("Fresh", (Twin,), {}))
    RENDERERS.restore(before)


TURN = {"rotation": torch.tensor([[0.7, 0.0, 0.7]], dtype=torch.float64)}


def test_an_adversary_that_does_not_fool_under_every_seed_has_held(twin: type[Twin]) -> None:
    """Turned on its corner the cube is no cabinet; under two of the eight other seeds the change is not seen."""
    every, _ = opinion(scene(), "pyrender", TURN, "twin")
    assert (every.share, every.outcome) == (1.0, "changed")
    twin.blind = frozenset([3, 4])
    some, _ = opinion(scene(), "pyrender", TURN, "twin")
    assert (some.share, some.outcome) == (0.75, "held")


def test_every_seed_draws_the_changed_scene(twin: type[Twin]) -> None:
    """A renderer that has no colours is given a scene in which the cube has another one, under each of the seeds."""
    drawn: list[Tensor] = []

    class Colorless(twin):  # type: ignore[misc, valid-type]
        def initial(self) -> dict[str, Tensor]:
            return {group: value for group, value in super().initial().items() if group != "color"}

        def render(self, parameters: Any) -> Tensor:
            images: Tensor = super().render(parameters)
            drawn.extend([to_bytes(images[0])] if self._seed else [])
            return images

    groups = tuple(group for group in PYRENDER.groups if group.name != "color")
    register(Declaration(name="colorless", groups=groups, differentiable=False, method="zoo"))(Colorless)
    change = {"color": torch.tensor([[-0.25, 0.0, -0.5]], dtype=torch.float64)}
    found, images = opinion(scene(), "pyrender", change, "colorless")
    assert (found.note, len(drawn)) == ("", 8)
    assert all(torch.equal(image, images["second_opinion_colorless_attacked.png"]) for image in drawn)


def test_a_renderer_that_fails_loses_no_finished_attack(twin: type[Twin]) -> None:
    twin.fails = True
    found, images = opinion(scene(), "pyrender", TURN, "twin")
    assert (found.failure, found.outcome, found.before, images) == ("its process was killed twice", None, None, {})
