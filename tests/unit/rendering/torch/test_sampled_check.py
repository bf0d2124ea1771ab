"""No image of an attack is further from the exact one than its plan states, wherever the attack takes the scene.

The exact image is compared with its definition in `test_renderer`. That images are further off without the check is a
mutant (`tests/unit/test_mutants.py`).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import pytest
import torch

from scene_attack.rendering.factory import build
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene

pytestmark = pytest.mark.slow


class Walk(NamedTuple):
    """Every value of the groups leaves the scene in a random direction, by at most `reach` in its group's unit."""

    shape: str
    material: str
    reach: dict[str, float]
    why: str


WALKS = [
    Walk("disc", "brushed-metal", {"normals": 2.4}, "one normal: the table is measured there, and left at once"),
    Walk("disc", "plastic", {"normals": 2.4}, "two layers with half of the tolerance each"),
    Walk("sphere", "plastic", {"normals": 0.5, "illumination": 10.0}, "the edge of a light moves over the table"),
    Walk("sphere", "glossy-paint", {"material": 1.0}, "the table is filled anew at every step"),
]


def renderer_of(walk: Walk, tolerance: float = 1e-3, size: int = 96) -> TorchRenderer:
    """A sphere, or a disc of one normal: it begins at a single place of the table."""
    scene = sphere_scene((size, size), 0.3 + 0.2 * sky(16, 32), (walk.material,))
    gbuffer = sphere_gbuffer(scene)
    if walk.shape == "disc":
        facing = gbuffer.normals[size // 2, size // 2] * (gbuffer.coverage > 0)[..., None]
        gbuffer = replace(gbuffer, normals=facing)
    return TorchRenderer(scene, gbuffer, tuple(walk.reach), tolerance)


def steps(walk: Walk, renderer: TorchRenderer, count: int = 7) -> Iterator[Parameters]:
    """The places of a walk, {group: [1, ...]}, the scene's own first."""
    random = torch.Generator().manual_seed(0)
    start, bounds = renderer.initial(), renderer.bounds()
    away = {group: 2 * torch.rand(start[group].shape, generator=random) - 1 for group in walk.reach}
    for step in range(count):
        far = step / (count - 1)
        yield {
            group: torch.clamp(start[group] + far * reach * away[group], *bounds[group])[None]
            for group, reach in walk.reach.items()
        }


@torch.no_grad()
def check(walk: Walk) -> TorchRenderer:
    """Compares the images of a walk with the exact ones; returns their renderer."""
    renderer = renderer_of(walk)
    errors = [
        float(
            (renderer.render(at).double() - renderer.exact().render({g: v.double() for g, v in at.items()})).abs().max()
        )
        for at in steps(walk, renderer)
    ]
    assert max(errors) <= renderer.plan.error <= 1e-3, f"{walk.why}: {max(errors):.1e} > {renderer.plan.error:.1e}"
    return renderer


@pytest.mark.parametrize("walk", WALKS[1:], ids=lambda walk: f"{walk.shape}-{walk.material}")
def test_every_image_is_within_the_plans_error(walk: Walk) -> None:
    check(walk)


def test_a_table_that_does_not_hold_is_noticed(kernel: str) -> None:  # noqa: ARG001 - by either kind of kernels
    assert check(WALKS[0]).failed_checks > 0


def test_the_plan_states_the_gradients_error() -> None:
    """A coarse table's gradient is measured to be worse than a fine one's; a sum's only rounds."""
    coarse, fine = (renderer_of(WALKS[0], tolerance).plan for tolerance in (1e-1, 1e-4))
    assert [gradient.group for gradient in coarse.gradients] == ["normals"]
    assert coarse.gradients[0].relative > 5 * fine.gradients[0].relative
    summed = renderer_of(WALKS[0], size=12).plan
    assert 0 < summed.gradients[0].relative < 1e-4
    assert summed.gradients[0].wrong_signs < 0.01


def test_no_table_is_chosen_whose_check_fails_in_the_scenes_own_image() -> None:
    """Its pixels would be summed after all in every image. Plastic has highlights that the measured normals miss."""
    thing = {"mesh": "primitive/sphere", "material": "plastic", "scale": 0.73, "color": [0.8, 0.6, 0.4]}
    scene = Scene.model_validate({"objects": [thing], "camera": {"size": [448, 448]}})
    renderer = build(resolve(scene, Library(Settings().cache_dir, Settings().data_dir)), "torch", groups=("normals",))
    assert any(stage.name.startswith("sampled check") for stage in renderer.plan.stages)
    renderer.render({"normals": renderer.initial()["normals"][None]})
    assert isinstance(renderer, TorchRenderer)
    assert renderer.failed_checks == 0
