"""When OpenGL draws instead of the rasteriser: by the measured error, by the scene, and by images that go wrong."""

import numpy as np
import pytest
import torch

from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender import rasteriser
from scene_attack.rendering.pyrender.planner import EVERY, is_sampled
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from tests.unit.rendering.pyrender.rasterised_scenes import rasterised, threads
from tests.unit.rendering.shapes import mesh, placed, quad, scene, six_parts, sphere

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("software_opengl")]

OBSTACLES = ["off by two steps", "nothing in the image", "no kernels", "a graphics card", "exact"]


def test_faces_without_area_are_left_to_opengl() -> None:
    """Their depth depends on rounding, so that no rule can tell which of them is visible."""
    renderer = PyrenderRenderer(placed(scene((120, 160), distance=3.2), mesh(threads(0, 20000))))
    assert not renderer.rasterises
    assert torch.equal(renderer.render({}), renderer.exact().render({}))


@pytest.mark.parametrize("place", ["far beyond the frame", "near plane"])
def test_opengl_draws_objects_at_the_near_plane_and_far_beyond_the_frame(place: str) -> None:
    ball_and_sheet = mesh(sphere(0.2, 24), quad(0.1, centre=(0, 0, 0.3)))
    renderer = rasterised(placed(scene((48, 64)), ball_and_sheet))
    camera = scene((48, 64)).camera
    to = (0.0, 0.0, camera.distance - (0.15 if place == "near plane" else 0.352))
    parameters = {"translation": torch.tensor([[to]], dtype=torch.float64)}
    assert renderer.radiance(parameters).any()
    assert torch.equal(renderer.radiance(parameters), renderer.exact().radiance(parameters))


@pytest.mark.parametrize("obstacle", OBSTACLES)
def test_opengl_draws_all_images_unless_the_rasteriser_is_within_tolerance(
    obstacle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = rasteriser.draw

    def off_by_two_steps(*arguments):
        drawn = true(*arguments)
        for own in drawn:
            if own is not None:
                own[0][..., :3] *= 1.05
        return drawn

    resolved, parameters, reason = placed(scene((48, 64)), six_parts()), {}, obstacle
    if obstacle == "off by two steps":
        monkeypatch.setattr(rasteriser, "draw", off_by_two_steps)
        reason = "beyond the tolerance ("
    elif obstacle == "no kernels":
        monkeypatch.setattr(compiled, "library", lambda: None)
    elif obstacle == "a graphics card":
        monkeypatch.setattr(context.Context, "software", False)
    elif obstacle == "nothing in the image":
        resolved = placed(scene((48, 64)), mesh(quad(0.1, centre=(9, 0, 0))))
        parameters = {"translation": torch.tensor([[[-9.0, 0.0, 0.0]]], dtype=torch.float64)}
        reason = "nothing is in the image"
    renderer = PyrenderRenderer(resolved, tolerance="exact" if obstacle == "exact" else 1e-3)
    assert not renderer.rasterises
    [passes] = [item for item in renderer.plan.items if item.what == "passes through OpenGL"]
    assert passes.kept == passes.of > 0
    assert reason.removeprefix("no ") in passes.why
    assert renderer.plan.error == 0
    images = renderer.radiance(parameters)
    assert images.any()
    assert torch.equal(images, renderer.exact().radiance(parameters))


def test_images_that_go_wrong_during_an_attack_are_found_and_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """One image in EVERY is drawn by OpenGL too, whichever batch it is in. The others are not checked."""
    small = placed(scene((24, 32)), mesh(sphere(0.4, 12), quad(0.2, centre=(0, 0.3, 0.3))))
    renderer = PyrenderRenderer(small, tolerance=5e-3)
    assert renderer.rasterises
    turns = torch.linspace(0, 1, 4 * EVERY, dtype=torch.float64)[:, None, None] * torch.tensor([0.0, 1.0, 0.0])
    assert renderer.render({"rotation": turns}).shape[0] > 0
    seen = renderer.sampled_error
    assert seen.mean < 5e-3
    true = rasteriser.draw

    def dark(*arguments):
        return [None if own is None else (own[0] * np.float32(0.9), own[1]) for own in true(*arguments)]

    monkeypatch.setattr(rasteriser, "draw", dark)
    images, exact = renderer.render({"rotation": turns}), renderer.exact().render({"rotation": turns})
    right = [row for row in range(len(turns)) if torch.equal(images[row], exact[row])]
    assert right == [row for row in range(len(turns)) if is_sampled({"rotation": turns}, row)]
    assert 1 <= len(right) <= 16
    assert renderer.sampled_error.mean > 5e-3
    alone = {"rotation": turns[right[0]][None]}
    assert torch.equal(renderer.render(alone)[0], exact[right[0]])
    monkeypatch.setattr(rasteriser, "draw", true)
    renderer.render(alone)
    assert renderer.sampled_error.mean > 5e-3  # the worst that was seen, not the last
