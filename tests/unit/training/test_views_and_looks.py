"""Views of the training against the renderers that the study uses."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from scene_attack.rendering.factory import build
from scene_attack.scenes.description import ELEVATION, Camera, Environment, Lights, Scene, SceneObject
from scene_attack.scenes.resolve import resolve
from training.batches import augmented, plain, shade
from training.looks import default_lamp, default_looks, environment_look, lamps_look, looks
from training.views import GRID, node_normals, nodes, paper_cameras, training_cameras, views

pytestmark = pytest.mark.slow

MESH = "furniture/couch"
AZIMUTH = 0.61
SIZE = 112


@pytest.fixture(scope="module")
def drawn(library, folder):
    return views(library, MESH, paper_cameras(2, SIZE), folder)


def _rendered(library, renderer, material="matte"):
    scene = Scene(
        objects=(SceneObject(mesh=MESH, material=material),), camera=Camera(azimuth=AZIMUTH, size=(SIZE, SIZE))
    )
    return build(resolve(scene, library), renderer, tolerance="exact").exact().render({})[0].float()


def _shaded(drawn, table):
    return shade(drawn, table[None], plain(np.array([0]), np.array([0])))[0].permute(1, 2, 0)


@pytest.mark.parametrize("material", ["matte", "plastic"])
def test_a_view_is_the_torch_renderers_image(library, drawn, material):
    # The look's camera is at azimuth 0, so the map turns the other way.
    table = environment_look(library, Environment(rotation=-AZIMUTH), material, ELEVATION)
    difference = (_shaded(drawn, table) - _rendered(library, "torch", material)).abs()
    # Base colours and coverage have 8 bits, normals a degree (gloss shows it more), and the map is averaged at another
    # turn.
    assert float(difference.mean()) < 2e-3
    assert float(difference.quantile(0.99)) < (0.03 if material == "matte" else 0.04)


def test_a_view_is_nearly_the_pyrender_renderers_image(library, drawn):
    table = lamps_look(Lights().ambient, [default_lamp(AZIMUTH, ELEVATION)], ELEVATION)
    difference = (_shaded(drawn, table) - _rendered(library, "pyrender")).abs()
    # The lamp is taken as far away, which changes its light by up to a third across the object.
    assert float(difference.mean()) < 0.02


def test_default_looks_are_the_default_scene_from_all_sides(library):
    found = default_looks(library, 4)
    assert found.shape == (8, GRID**2, 6)
    assert torch.equal(found[1], environment_look(library, Environment(rotation=-np.pi / 2), "matte", ELEVATION))
    assert torch.equal(found[6], lamps_look(Lights().ambient, [default_lamp(0.0, ELEVATION)], ELEVATION))


def test_a_view_is_drawn_once(library, drawn, folder, monkeypatch):
    def refuse(*_):
        raise AssertionError("it was drawn again")

    monkeypatch.setattr("training.views.rasterise", refuse)
    again = views(library, MESH, paper_cameras(2, SIZE), folder)
    assert again.side == drawn.side
    assert np.array_equal(again.pixels, drawn.pixels)
    assert np.array_equal(again.starts, drawn.starts)


def test_shifts_and_mirrors_move_the_image(drawn, library):
    table = environment_look(library, Environment(), "matte", ELEVATION)[None]
    middle = plain(np.array([0]), np.array([0]))
    image = shade(drawn, table, middle)
    mirrored = shade(drawn, table, replace(middle, mirrored=np.array([True])))
    assert torch.equal(mirrored, image.flip(3))
    moved = shade(drawn, table, replace(middle, shifts=np.array([[4, -3]])))
    assert torch.equal(moved[:, :, : SIZE - 4, 3:], image[:, :, 4:, : SIZE - 3])


def test_nodes_are_the_nearest_normals():
    normals = torch.nn.functional.normalize(torch.randn(4000, 3, dtype=torch.float64), dim=-1)
    normals[:, 2] = normals[:, 2].abs()
    found = node_normals()[nodes(normals)]
    # A cell of an equal-area map of the hemisphere has a solid angle of 2π / (π/4 · GRID²).
    assert float((found * normals).sum(-1).clamp(-1, 1).arccos().max()) < 4 * (8 / GRID**2) ** 0.5
    assert torch.allclose(node_normals().norm(dim=-1), torch.ones(GRID**2, dtype=torch.float64))


def test_cameras_are_near_the_papers_and_the_same_again():
    cameras = training_cameras(MESH, 24, 0, SIZE)
    assert cameras == training_cameras(MESH, 24, 0, SIZE)
    assert cameras != training_cameras(MESH, 24, 1, SIZE)
    assert all(abs(camera.elevation - ELEVATION) <= 0.17 for camera in cameras)
    gaps = np.diff(np.sort([camera.azimuth for camera in cameras]))
    assert gaps.max() < 2 * 2 * np.pi / 24


def test_looks_and_choices_follow_from_the_seed(library, drawn):
    assert torch.equal(looks(library, 4, 7), looks(library, 4, 7))
    assert not torch.equal(looks(library, 4, 7), looks(library, 4, 8))
    one = augmented(drawn, np.arange(8) % 2, 4, np.random.default_rng(3))
    levels = one.grounds.astype(np.float64) * 255
    assert np.abs(levels - levels.round()).max() < 1e-4
    assert one.looks.max() < 4
