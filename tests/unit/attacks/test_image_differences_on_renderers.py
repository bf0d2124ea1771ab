"""Gradients by differences of the image through the real renderers and the real network, in float64."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity

from scene_attack.attacks.differences import ImageDifferences, measure_image_half_steps
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, differentiate, evaluate
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack.targets import registry
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.protocol import Target
from tests.unit.jobs.small import LIBRARY

pytestmark = pytest.mark.slow

SIZE = (32, 32)
GROUPS = {"illumination": 3, "material": 5}
"""Coordinates of each group of the torch renderer that are attacked: a few, spread over the group."""


def ball() -> ResolvedScene:
    return resolve(
        Scene.model_validate(
            {
                "objects": [{"mesh": "furniture/soccer-ball", "material": "plastic"}],
                "camera": {"size": SIZE},
                "lights": {"environment": {"size": [8, 16]}},
            }
        ),
        LIBRARY,
    )


def network() -> Classifier:
    target = registry.load("efficientnet-lite0", torch.float64)
    assert isinstance(target, Classifier)
    return replace(target, input_size=SIZE)  # the network takes any size, and float64 is slow


@dataclass
class Few:
    """A renderer of some of another's coordinates, which passes on its gradients only if `differentiable`."""

    whole: Renderer
    differentiable: bool

    name = "few"
    groups = tuple(GROUPS)

    def __getattr__(self, name: str) -> object:
        return getattr(self.whole, name)

    def chosen(self, group: str) -> Tensor:
        """Flat indices: of the texels those that are bright, so that a step down stays within bounds."""
        values = self.whole.initial()[group].flatten()
        order = values.argsort(descending=True) if group == "illumination" else torch.arange(len(values))
        return order[:: len(order) // GROUPS[group] // (4 if group == "illumination" else 1)][: GROUPS[group]]

    def initial(self) -> Parameters:
        return {group: self.whole.initial()[group].flatten()[self.chosen(group)] for group in GROUPS}

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        def of(bound: Tensor, group: str) -> Tensor:
            return bound.expand_as(self.whole.initial()[group]).flatten()[self.chosen(group)]

        bounds = self.whole.bounds()
        return {group: (of(bounds[group][0], group), of(bounds[group][1], group)) for group in GROUPS}

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        given = {}
        for group, values in parameters.items():
            start = self.whole.initial()[group]
            flat = start.flatten().expand(len(values), -1).index_copy(1, self.chosen(group), values)
            given[group] = flat.reshape(-1, *start.shape)
        images = self.whole.render(given)
        return images if self.differentiable else images.detach()


def problem(renderer: Renderer, target: Target, groups: tuple[str, ...] = ()) -> AttackProblem:
    with torch.no_grad():
        first = int(target.logits(renderer.render({g: v[None] for g, v in renderer.initial().items()})).argmax())
    return AttackProblem.of(
        renderer, target, ResolvedGoal((first,), None), Limits.of(renderer, groups or renderer.groups)
    )


def place(case: AttackProblem, seed: int, size: float) -> Tensor:
    random = torch.Generator().manual_seed(seed)
    start, shapes = case.initial, case.layout.shapes.values()
    return torch.cat([size * (torch.rand(s, generator=random, dtype=start.dtype) - 0.5).flatten() for s in shapes])


def found(case: AttackProblem, at: Tensor) -> Tensor:
    """The gradient on the float image."""
    look = evaluate(case, at, 0, gradient=True)
    gradient = differentiate(case, replace(look, scores=case.scores(look.image)[0])).gradient
    assert gradient is not None
    return gradient.double()


def differenced(case: AttackProblem, half_steps: dict[str, float]) -> AttackProblem:
    return replace(case, differences=ImageDifferences.at(case, half_steps))


def test_through_the_torch_renderer_they_are_those_of_autograd() -> None:
    """In scale and in direction; of images of one scene and one network."""
    scene, target = ball(), network()
    whole = TorchRenderer(scene, rasterise(scene), tolerance="exact")
    smooth, opaque = (problem(Few(whole, has), target) for has in (True, False))
    opaque = differenced(opaque, dict.fromkeys(GROUPS, 1e-3))
    assert torch.equal(smooth.original, opaque.original)
    places = [place(opaque, seed, 0.5) for seed in (0, 4, 7, 32, 63)]
    ours = [found(opaque, at) for at in places]
    for mine, at in zip(ours, places, strict=True):
        true = found(smooth, at)
        torch.testing.assert_close(mine, true, rtol=1e-6, atol=1e-6 * float(true.abs().max()))
    assert float(cosine_similarity(ours[0], ours[1], dim=0)) < 0.9999  # the places differ, and can be told


class Straight:
    """Two labels, whose log-odds are linear in the image. Over the steps of a difference nothing bends."""

    name, labels = "straight", ("one", "other")

    def __init__(self) -> None:
        random = torch.Generator().manual_seed(0)
        self.weights = torch.randn(3 * SIZE[0] * SIZE[1], 2, generator=random, dtype=torch.float64) / 50

    def logits(self, images: Tensor) -> Tensor:
        return images.double().flatten(1) @ self.weights


def differences_of_the_objective(case: AttackProblem, at: Tensor, half_steps: dict[str, float]) -> Tensor:
    """One image after the other, each shown to the network."""
    layout = case.layout
    steps, found = layout.spread(half_steps), torch.zeros(layout.total, dtype=torch.float64)
    for k in range(layout.total):
        values, places = [], []
        for sign in (1, -1):
            moved = at.clone()
            moved[k] += sign * steps[k]
            inside = case.limits.clamp(moved)
            images = case.renderer.render(layout.unflatten((case.initial + inside)[None]))
            values.append(case.goal.objective(case.target.logits(images.double()))[0])
            places.append(inside[k])
        found[k] = (values[0] - values[1]) / (places[0] - places[1])
    return found


def test_through_pyrender_they_are_differences_of_the_objective() -> None:
    """Of float images, at the measured steps. The object is white, so that its colour is at a bound."""
    case = problem(PyrenderRenderer(ball(), PYRENDER.group_names), Straight())  # type: ignore[arg-type]
    chosen = measure_image_half_steps(case)
    at = case.limits.clamp(place(case, 0, 0.05))
    case.layout.unflatten(at)["color"].zero_()
    ours = found(differenced(case, chosen), at)
    wanted = differences_of_the_objective(case, at, chosen)
    assert len(wanted) == 18
    assert bool((wanted.abs() > 1e-3).all())
    torch.testing.assert_close(ours, wanted, rtol=1e-4, atol=1e-4)


def test_through_pyrender_and_the_real_network_they_are_near_differences_of_the_objective() -> None:
    """The network bends between the two images of a difference: little, as light and colour change them little."""
    case = problem(PyrenderRenderer(ball(), ("illumination", "color")), network(), ("illumination", "color"))
    small = dict.fromkeys(case.layout.groups, 1e-3)
    at = place(case, 0, 0.05)
    color = case.layout.unflatten(at)["color"]
    color.copy_(-color.abs() - 0.01)
    ours = found(differenced(case, small), at)
    wanted = differences_of_the_objective(case, at, small)
    assert float(cosine_similarity(ours, wanted, dim=0)) > 0.999
    assert float(ours.norm() / wanted.norm()) == pytest.approx(1, abs=0.03)
