"""How far rasterised images and their gradients are from OpenGL's, for random scenes, catalogue models and drivers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from scene_attack.rendering.pyrender.planner import both_sides
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import Mesh
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings
from tests.unit.rendering.pyrender.rasterised_scenes import (
    GLASS,
    LIGHTS,
    error,
    moved,
    rasterised,
    soup,
    texels,
    wrinkled,
)
from tests.unit.rendering.shapes import PLATFORMS, mesh, on_platform, part, placed, quad, scene, six_parts, sphere

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("software_opengl")]


@pytest.mark.parametrize(
    "made",
    [
        lambda seed: mesh(soup(seed, 4000, 0.03), soup(seed + 50, 300, 0.1, (0.9, 0.3, 0.2, 1))),
        lambda seed: mesh(wrinkled(seed, 60), soup(seed, 500, 0.05)),
        lambda seed: mesh(soup(seed, 400, 0.1, texture=texels(seed, 32, 64)), six_parts().parts[seed]),
        lambda seed: mesh(
            soup(seed, 400, 0.1, texture=texels(seed, 37 - 36 * (seed % 2), 5 + seed)), wrinkled(seed, 9)
        ),
        lambda seed: mesh(soup(seed, 200, 0.1, texture=texels(seed, 16, 16, holes=True)), wrinkled(seed, 24)),
        lambda seed: mesh(soup(seed, 60, 0.2, GLASS), soup(seed + 1, 60, 0.2, GLASS), wrinkled(seed, 24)),
        lambda seed: mesh(soup(seed, 60, 0.2, GLASS, texture=texels(seed, 9, 9, holes=True)), soup(seed, 500, 0.05)),
    ],
    ids=["small", "watertight", "textured", "odd texture", "holes", "glass", "glass with holes"],
)
@pytest.mark.parametrize("seed", range(3))
def test_images_equal_those_of_opengl_but_for_a_few_samples(made: Callable[[int], Mesh], seed: int) -> None:
    """Unordered triangles are the worst case: at every edge between them rounding decides. So are textures of noise:
    the slightest difference in the mipmap level changes a pixel a little."""
    size = [(120, 160), (97, 131), (224, 224)][seed]
    lights = [Lights(), LIGHTS, Lights(ambient=0.7, points=())][seed]
    view = scene(size, lights=lights, azimuth=0.5 * seed, elevation=0.3, distance=3.2)
    renderer = rasterised(placed(view, made(seed)))
    found = error(renderer, moved(renderer, seed))
    assert found.mean < 3e-3
    assert found.share < (0.1 if any(part.texture is not None for part in made(seed).parts) else 0.02)


def test_large_faces_and_large_images_are_within_tolerance() -> None:
    """Some edges need more than 32 bits, and one face covers most of the frame."""
    far = mesh(quad(1.05, centre=(0, 0, -0.5)), wrinkled(1, 12), soup(3, 20, 0.3))
    assert error(rasterised(placed(scene((900, 1200), distance=4.5), far)), {}).within(1e-3)


def test_objects_that_the_frame_clips_are_within_tolerance() -> None:
    renderer = rasterised(placed(scene((48, 64)), mesh(sphere(0.4, 24), quad(0.1, centre=(0, 0, 0.45)))))
    camera = scene((48, 64)).camera
    border = camera.distance * np.tan(camera.field_of_view / 2) * 64 / 48
    cut = {"translation": torch.tensor([[[x, y, 0.0]] for x in (-border, 0, border) for y in (-1, 0)]).double()}
    found = error(renderer, cut)  # the least of these has 70 pixels
    assert found.mean < 1e-3
    assert found.share < 0.03


def test_a_disc_seen_from_its_edge_is_within_a_few_pixels() -> None:
    """Where a sample meets it, the pixel's centre lies many times its width beside it, and what is extrapolated to
    there depends on the last bits. Fifteen pixels were off; now OpenGL draws such images."""
    angles = np.linspace(0, 2 * np.pi, 65)[:-1]
    points = np.append(0.5 * np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1), [[0, 0, 0]], axis=0)
    fan = np.array([[64, (k + 1) % 64, k] for k in range(64)])
    disc = part(points, fan, np.tile([0.0, 1.0, 0.0], (65, 1)), (0.9, 0.6, 0.3, 1))
    renderer = rasterised(placed(scene((112, 112), lights=LIGHTS, distance=2.2), mesh(disc)))
    tilts = torch.linspace(-0.02, 0.02, 41, dtype=torch.float64)
    turns = torch.zeros(41, 1, 3, dtype=torch.float64)
    turns[:, 0, 0], turns[:, 0, 2] = tilts, 0.3
    ours, exact = (of.render({"rotation": turns}) for of in (renderer, renderer.exact()))
    off = ((ours - exact).abs().amax(-1) > 1 / 255).sum((1, 2))
    assert int(off.max()) <= 4


def test_gradients_are_as_smooth_as_those_of_opengl() -> None:
    """Differences of the mean image along a path of small steps vary as much as OpenGL's do: the same samples change
    from face to face."""
    renderer = rasterised(placed(scene((96, 128)), mesh(wrinkled(0, 40), soup(1, 99, 0.2))))
    steps = torch.linspace(0, 0.02, 41, dtype=torch.float64)
    for group in ("translation", "rotation"):
        path = torch.zeros(41, 1, 3, dtype=torch.float64)
        path[:, 0, 0] = steps
        ours, exact = (of.render({group: path}).double().mean((1, 2, 3)).diff() for of in (renderer, renderer.exact()))
        assert ours.std() < 1.1 * exact.std()
        assert (ours - exact).std() < 0.2 * exact.std()


@pytest.mark.parametrize(
    "model", ["electric-guitar", "helmet", "pool-table", "radiator3", "speaker", "video-projector"]
)
def test_catalogue_models_are_within_the_default_tolerance(model: str, tmp_path: Path) -> None:
    """They have 436 to 56 thousand faces. Some are open, some watertight; some have textures, holes or glass."""
    found = Scene.model_validate({"objects": [{"mesh": f"furniture/{model}"}]})
    tolerance = 2e-3 if model == "helmet" else 1e-3  # its images are within 1e-3, but not the gradients of its rotation
    renderer = PyrenderRenderer(resolve(found, Library(Settings().cache_dir, tmp_path)), tolerance=tolerance)
    assert renderer.rasterises
    [stage] = [stage for stage in renderer.plan.stages if stage.name == "rasterise"]
    here = error(renderer, both_sides(renderer.initial(), renderer.plan.groups))
    assert here.mean <= stage.error <= 2e-3
    assert here.share <= stage.share <= 0.02


@pytest.mark.parametrize("platform", PLATFORMS)
def test_images_equal_those_of_either_platforms_opengl(platform: str) -> None:
    code = """if True:
        from tests.unit.rendering.pyrender import rasterised_scenes as made
        from tests.unit.rendering.shapes import mesh, placed, scene
        glass, holes = made.soup(1, 60, 0.1, made.GLASS), made.soup(2, 99, 0.1, texture=made.texels(0, 8, 8, True))
        renderer = made.rasterised(placed(scene(distance=3.2), mesh(glass, holes, made.wrinkled(0, 20))))
        found = made.error(renderer, made.moved(renderer, 0))
        print(renderer.rasterises, found.mean < 3e-3, found.share < 0.02)
    """
    assert on_platform(platform, code).split() == ["True", "True", "True"]
