"""The errors of gradients that a plan of rasterised images states, against central differences of OpenGL's images."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from scene_attack.rendering.pyrender.planner import both_sides
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_service.settings import Settings

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("software_opengl")]

GROUPS = ("illumination", "color", "translation", "rotation")
HALF_STEP = 0.01


@pytest.fixture(scope="module")
def touching(tmp_path_factory: pytest.TempPathFactory) -> ResolvedScene:
    """Three objects that touch: two of them have faces that coincide, of which rounding decides which is seen."""
    meshes = ("furniture/helmet", "furniture/speaker", "furniture/barrel")
    objects = [
        {"mesh": mesh, "scale": 0.5, "translation": (0.5 * (k - 1), 0.0, 0.0), "color": (0.8, 0.3 + 0.2 * k, 0.3)}
        for k, mesh in enumerate(meshes)
    ]
    scene = Scene.model_validate({"objects": objects, "camera": {"size": (112, 112)}})
    return resolve(scene, Library(Settings().cache_dir, tmp_path_factory.mktemp("data")))


def differences(images: Tensor) -> Tensor:
    """Central differences [coordinates, values] of images [2 · coordinates, H, W, 3]."""
    return (images[::2] - images[1::2]).double().flatten(1) / (2 * HALF_STEP)


def test_the_plan_states_the_error_of_gradients(touching: ResolvedScene) -> None:
    """As random weights show it at all 32 coordinates. 300 weights leave it uncertain by 8 %, and signs by 0.01."""
    renderer = PyrenderRenderer(touching, GROUPS, tolerance=1.0)
    assert renderer.rasterises
    assert tuple(one.group for one in renderer.plan.gradients) == GROUPS
    random, largest = torch.Generator().manual_seed(0), 0.0
    for stated in renderer.plan.gradients:
        sides = both_sides(renderer.initial(), (stated.group,), HALF_STEP)
        own, true = differences(renderer.render(sides)), differences(renderer.exact().render(sides))
        weights = torch.randn(own.shape[1], 300, generator=random, dtype=torch.float64)
        gradients, exact = own @ weights, true @ weights
        relative = float((gradients - exact).norm() / exact.norm())
        wrong = float((gradients.sign() != exact.sign()).double().mean())
        assert stated.relative == pytest.approx(relative, rel=0.25), stated.group
        assert stated.wrong_signs == pytest.approx(wrong, rel=0.25, abs=0.01), stated.group
        largest = max(largest, relative)
    assert largest > 0.05


def test_opengl_draws_if_gradients_are_off_by_more_than_the_tolerance_allows(touching: ResolvedScene) -> None:
    """A tolerance t allows a relative error of 100 t: the images alone are within this one."""
    loose = PyrenderRenderer(touching, GROUPS, tolerance=1.0).plan
    tolerance = max(one.relative for one in loose.gradients) / 101
    assert loose.error < tolerance
    renderer = PyrenderRenderer(touching, GROUPS, tolerance=tolerance)
    assert not renderer.rasterises
    assert renderer.plan.error == 0
    assert renderer.plan.error_is == "maximum"
    assert renderer.plan.gradients == ()
    [passes] = [item for item in renderer.plan.items if item.what == "passes through OpenGL"]
    assert passes.kept == passes.of
    assert "the error of its gradients is beyond the tolerance" in passes.why
    assert "rotation 0." in passes.why
    assert torch.equal(renderer.render({}), renderer.exact().render({}))


def test_one_object_among_many_counts(tmp_path: Path) -> None:
    """Six cubes are drawn as by OpenGL, a helmet between them is not; most coordinates are not measured."""
    meshes = ["primitive/cube"] * 3 + ["furniture/helmet"] + ["primitive/cube"] * 3
    objects = [
        {"mesh": mesh, "scale": 0.35 if "helmet" in mesh else 0.16, "translation": (0.28 * (k - 3), 0.0, 0.0)}
        for k, mesh in enumerate(meshes)
    ]
    scene = Scene.model_validate({"objects": objects})
    renderer = PyrenderRenderer(resolve(scene, Library(Settings().cache_dir, tmp_path)), GROUPS)
    assert not renderer.rasterises
    [passes] = [item for item in renderer.plan.items if item.what == "passes through OpenGL"]
    assert "the error of its gradients is beyond the tolerance" in passes.why


def test_groups_that_are_not_attacked_do_not_count(touching: ResolvedScene) -> None:
    renderer = PyrenderRenderer(touching, GROUPS[:2])
    assert renderer.rasterises
    assert renderer.plan.error_is == "mean"
    assert {one.group for one in renderer.plan.gradients} == set(GROUPS[:2])
    assert all(one.relative <= 0.1 for one in renderer.plan.gradients)


def test_a_helmet_s_rotation_is_left_to_opengl(tmp_path: Path) -> None:
    """By the default tolerance, of a request as a user sends it."""
    scene = Scene.model_validate({"objects": [{"mesh": "furniture/helmet"}]})
    renderer = PyrenderRenderer(resolve(scene, Library(Settings().cache_dir, tmp_path)))
    assert not renderer.rasterises
