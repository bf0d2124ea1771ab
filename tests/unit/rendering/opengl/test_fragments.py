"""The surfaces of a pixel, apart: on made-up samples, and of a cube on a floor."""

from math import cos, radians, sin

import pytest
import torch

from scene_attack.rendering.opengl.gbuffer import SURFACES, fragments, rasterise
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings

UP, SIDE = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def pixel(*samples: tuple[int, tuple[float, float, float], float]):
    """One pixel of 16 samples: the object's number from 1 (0: none), normal and depth of each; its colour is 0.1 times
    the number."""
    assert len(samples) == 16
    geometry = torch.tensor([(*normal, depth) for _, normal, depth in samples]).reshape(4, 4, 4)
    surface = torch.tensor([(0.1 * number,) * 3 + (float(number),) for number, _, _ in samples]).reshape(4, 4, 4)
    means = {
        "coverage": torch.tensor([[sum(number > 0 for number, _, _ in samples) / 16]]),
        "normals": torch.tensor([[[1.0, 0.0, 0.0]]]),
        "base_color": torch.full((1, 1, 3), 0.7),
        "depth": torch.tensor([[7.0]]),
        "object_index": torch.tensor([[7]]),
    }
    return fragments(geometry, surface, means, 4, torch.tensor([[5]]))


def test_a_pixel_of_one_surface_keeps_its_mean() -> None:
    bent = (0.0, cos(radians(5)), sin(radians(5)))
    found = pixel(*[(1, UP, 2.0), (1, bent, 2.0)] * 8)
    assert found.pixels.tolist() == [5]
    assert found.rank.tolist() == [0]
    assert found.object_index.tolist() == [7]
    assert float(found.depth) == 7.0
    assert found.place.tolist() == [[0.5, 0.5]]


def test_surfaces_come_by_their_share_with_their_own_means() -> None:
    """A row of nothing, one of a cube's side, one of its top, and the floor above: OpenGL's rows go upwards."""
    samples = [(0, (0.0, 0.0, 0.0), 0.0)] * 4 + [(2, SIDE, 1.0)] * 4 + [(2, UP, 2.0)] * 2 + [(1, UP, 3.0)] * 6
    found = pixel(*samples)
    assert found.pixels.tolist() == [5, 5, 5]
    assert found.rank.tolist() == [0, 1, 2]
    assert found.share.tolist() == [6 / 16, 4 / 16, 2 / 16]
    assert found.object_index.tolist() == [0, 1, 1]
    torch.testing.assert_close(found.normals, torch.tensor([UP, SIDE, UP]))
    assert found.depth.tolist() == [3.0, 1.0, 2.0]
    assert found.base_color[:, 0].tolist() == pytest.approx([0.1, 0.2, 0.2])
    # The side's row is the second from below; the floor has half of the third from below, and all of the uppermost.
    assert found.place[1].tolist() == [0.5, pytest.approx(1 - 0.375)]
    assert found.place[0].tolist() == [
        pytest.approx((2 * 0.75 + 4 * 0.5) / 6),
        pytest.approx((2 * 0.375 + 4 * 0.125) / 6),
    ]


def test_what_is_left_counts_with_the_largest() -> None:
    found = pixel(*[(1, UP, 1.0)] * 4, *[(number, UP, 1.0) for number in range(2, 14)])
    assert len(found.rank) == SURFACES
    assert float(found.share.sum()) == 1.0
    assert float(found.share[0]) == 13 / 16


def test_an_image_is_covered_as_before(tmp_path) -> None:
    description = Scene.model_validate(
        {
            "camera": {"size": (30, 40), "elevation": 0.6, "distance": 3.0},
            "objects": [{"mesh": "primitive/cube", "rotation": (0, 0.5, 0), "scale": 0.5, "translation": (0, 0.2, 0)}],
            "floor": {"size": 2.0, "height": -0.1},
        }
    )
    gbuffer = rasterise(resolve(description, Library(Settings().cache_dir, tmp_path)))
    found = gbuffer.fragments
    assert found is not None
    total = torch.zeros(30 * 40).index_add(0, found.pixels, found.share).reshape(30, 40)
    torch.testing.assert_close(total, gbuffer.coverage)
    first = found.rank == 0
    assert (first.sum(), len(found.pixels[first].unique())) == ((gbuffer.coverage > 0).sum(),) * 2
    # Every normal is that of a face, none a mean of several; the mean image has many.
    upright = (found.normals[:, 1] > 0.999) | (found.normals[:, 1].abs() < 1e-3)
    assert upright.all()
    means = gbuffer.normals[gbuffer.coverage > 0]
    assert ((means[:, 1] < 0.99) & (means[:, 1] > 0.1)).sum() > 10


def test_without_a_floor_there_are_none(tmp_path) -> None:
    description = Scene.model_validate({"camera": {"size": (12, 16)}, "objects": [{"mesh": "primitive/cube"}]})
    gbuffer = rasterise(resolve(description, Library(Settings().cache_dir, tmp_path)))
    assert gbuffer.fragments is None
    whole = gbuffer.surfaces()
    assert len(whole.pixels) == (gbuffer.coverage > 0).sum()
    assert torch.equal(whole.normals, gbuffer.normals.reshape(-1, 3)[whole.pixels])
