from math import pi, tan

import numpy as np
import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.opengl import gbuffer
from scene_attack.rendering.opengl.gbuffer import FACTOR, rasterise
from scene_attack.scenes.description import Scene
from tests.unit.rendering import shapes
from tests.unit.rendering.shapes import disk, mesh, placed, quad, scene, sphere


def test_sphere_normals_are_those_of_the_sphere_seen_from_anywhere() -> None:
    description = scene((128, 160), azimuth=0.61, elevation=0.35)
    eye, ray = shapes.rays(description.camera)
    a, b, c = (ray * ray).sum(-1), (ray @ eye), eye @ eye - 0.25
    hit = b * b - a * c > 0
    distance = (-b - np.sqrt(np.where(hit, b * b - a * c, 0))) / a
    exact = (eye + distance[..., None] * ray) * 2
    result = rasterise(placed(description, mesh(sphere(0.5))))
    inside = result.coverage.numpy() == 1
    assert hit[inside].all()
    cosines = (result.normals.numpy() * exact).sum(-1)[inside]
    # Over a pixel the mean normal of a curved surface is not that of its middle: 0.7 degrees at the rim, less inside.
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    assert angles.max() < 1.0
    assert angles.mean() < 0.05  # looking through the pixel's corner instead of its middle would make it 0.8
    # Away from the rim, where depth bends within a pixel; the chords of 96 rings lie up to 1.3e-4 inside the sphere.
    middle = inside & (-(exact * ray).sum(-1) > 0.5)
    assert np.abs(result.depth.numpy() - distance)[middle].max() < 1e-3


def test_normals_are_unit_and_nothing_is_said_where_nothing_is() -> None:
    result = rasterise(placed(scene(), mesh(sphere(0.5))))
    seen = result.coverage > 0
    assert 0.2 < seen.float().mean() < 0.6
    torch.testing.assert_close(result.normals.norm(dim=-1), seen.float(), atol=1e-5, rtol=0)
    for image in (result.base_color, result.depth, result.normals):
        assert (image[~seen] == 0).all()
    assert (result.object_index[seen] == 0).all()
    assert (result.object_index[~seen] == -1).all()


def test_coverage_of_a_disk_is_its_area() -> None:
    description = scene((90, 120))
    result = rasterise(placed(description, mesh(disk(0.5))))
    radius = 0.5 / 1.8 / tan(description.camera.field_of_view / 2) * 90 / 2
    # 16 samples a pixel: an edge pixel is wrong by about 1/16 at random, over 240 edge pixels 0.5 of 2900 together.
    assert result.coverage.sum().item() == pytest.approx(pi * radius**2, rel=1e-3)
    partial = (result.coverage > 0) & (result.coverage < 1)
    assert 150 < partial.sum() < 400
    # One sample a pixel would leave no partial pixels; so would thresholding.
    assert len(result.coverage[partial].unique()) > 10
    np.testing.assert_allclose(result.depth[result.coverage > 0], 1.8, rtol=1e-5)  # on the edge too


def test_depth_of_a_slanted_plane_is_measured_along_the_view() -> None:
    description = scene((60, 80), azimuth=0.4, elevation=0.5)
    eye, ray = shapes.rays(description.camera)
    exact = -eye[2] / ray[..., 2]
    result = rasterise(placed(description, mesh(quad(3.0))))
    assert (result.coverage == 1).all()
    # Depth is not linear over a pixel; its mean differs from the middle by the curvature, 1e-4 here.
    np.testing.assert_allclose(result.depth.numpy(), exact, rtol=3e-4)
    np.testing.assert_allclose(result.normals.numpy(), np.broadcast_to([0, 0, 1], (*exact.shape, 3)), atol=1e-6)


def test_the_back_of_a_sheet_faces_the_viewer() -> None:
    result = rasterise(placed(scene(azimuth=pi), mesh(quad(3.0))))
    np.testing.assert_allclose(result.normals.numpy()[..., 2], -1, atol=1e-6)


def test_normals_bent_over_the_horizon_are_put_on_it() -> None:
    sheet = quad(6.0)
    sheet.normals[:] = np.array([0.9, 0.0, 0.3]) / np.linalg.norm([0.9, 0.0, 0.3])
    description = scene((20, 60), field_of_view=1.2)
    _, ray = shapes.rays(description.camera)
    result = rasterise(placed(description, mesh(sheet)))
    facing = -(result.normals.numpy() * ray).sum(-1)
    assert facing.min() > -0.02  # the pixel's middle, against the mean of samples that are each >= 0
    assert (facing < 0.01).any()
    assert (result.normals[..., 0] > 0).all()  # none was turned round: that would make a seam down the image


def test_the_nearer_object_hides_the_other_and_pixels_name_their_object() -> None:
    description = scene((64, 96), objects=2)
    far, near = quad(0.6, centre=(-0.3, 0, 0), color=(1, 0, 0, 1)), quad(0.3, centre=(0.2, 0, 0.2), color=(0, 0, 1, 1))
    result = rasterise(placed(description, mesh(far), mesh(near)))
    index, color = result.object_index.numpy(), result.base_color.numpy()
    assert index[32, 20] == 0
    assert index[32, 56] == 1  # both lie on this ray
    assert index[2, 90] == -1
    np.testing.assert_allclose(color[32, 56], [0, 0, 1], atol=1e-6)
    assert set(np.unique(index)) == {-1, 0, 1}
    # The image does not depend on the order of the objects, except whose a pixel is that both cover equally.
    untied = result.base_color[..., 0] != result.base_color[..., 2]
    swapped = rasterise(placed(description, mesh(near), mesh(far)))
    assert torch.equal(swapped.base_color, result.base_color)
    assert torch.equal((swapped.object_index == 0)[untied], (result.object_index == 1)[untied])


def test_base_color_is_texture_times_part_times_object_in_linear_light() -> None:
    texture = np.zeros((2, 2, 4), np.uint8)
    texture[..., 3] = 255
    texture[0, 0, :3], texture[0, 1, :3] = (255, 0, 0), (0, 255, 0)
    texture[1, 0, :3], texture[1, 1, :3] = (0, 0, 255), (128, 128, 128)
    large = texture.repeat(64, 0).repeat(64, 1)
    base = scene((64, 64), distance=1.8)
    thing = base.objects[0].model_copy(update={"color": (0.5, 1.0, 0.25)})
    description = Scene(camera=base.camera, objects=(thing,))
    result = rasterise(placed(description, mesh(quad(0.5, color=(0.8, 1, 1, 1), texture=large)))).base_color.numpy()
    assert_color = lambda row, column, want: np.testing.assert_allclose(result[row, column], want, atol=2e-3)  # noqa: E731
    assert_color(24, 24, [0.4, 0, 0])  # row 0 of the texture is at the top
    assert_color(24, 40, [0, 1, 0])
    assert_color(40, 24, [0, 0, 0.25])
    grey = ((128 / 255 + 0.055) / 1.055) ** 2.4
    assert_color(40, 40, [0.4 * grey, grey, 0.25 * grey])


def test_texels_without_alpha_are_holes() -> None:
    texture = np.full((64, 64, 4), 255, np.uint8)
    texture[:, :32, 3] = 0
    result = rasterise(placed(scene((64, 64)), mesh(quad(0.5, texture=texture))))
    assert result.coverage[32, 24] == 0
    assert result.coverage[32, 40] == 1


def test_opacity_counts_as_a_share_of_the_samples() -> None:
    glass = quad(0.5, centre=(0, 0, 0.1), color=(1, 0, 0, 0.25))
    alone = rasterise(placed(scene((32, 32)), mesh(glass)))
    assert alone.coverage[16, 16] == 0.25
    wall = quad(3.0, color=(0, 0, 1, 1))
    both = rasterise(placed(scene((32, 32)), mesh(glass, wall)))
    assert both.coverage[16, 16] == 1
    np.testing.assert_allclose(both.base_color[16, 16], [0.25, 0, 0.75], atol=1e-6)


def test_an_object_out_of_view_is_refused() -> None:
    base = scene((32, 32))
    thing = base.objects[0].model_copy(update={"translation": (5.0, 0.0, 0.0)})
    with pytest.raises(InvalidRequest, match="out of view") as caught:
        rasterise(placed(Scene(camera=base.camera, objects=(thing,)), mesh(sphere(0.5))))
    assert caught.value.field == "scene.objects"


def test_tiles_join_without_a_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    resolved = placed(scene((70, 90), azimuth=0.3, elevation=0.2), shapes.six_parts())
    whole = rasterise(resolved)
    monkeypatch.setattr(gbuffer, "TILE", 32)
    tiled = rasterise(resolved)
    # The samples are the same points; rounding may flip one that lies on an edge.
    assert ((whole.coverage - tiled.coverage).abs() > 1e-6).float().mean() < 2e-3
    assert (whole.coverage - tiled.coverage).abs().max() <= 2 / 16
    same = (whole.coverage == 1) & (tiled.coverage == 1)
    assert ((whole.depth - tiled.depth).abs()[same] < 1e-3).float().mean() > 0.99


def test_the_same_scene_gives_the_same_bits_again_and_after_others() -> None:
    resolved = placed(scene((48, 64), azimuth=0.3), shapes.six_parts())
    first = rasterise(resolved)
    rasterise(placed(scene((33, 47)), mesh(sphere(0.4), disk(0.3))))
    again = rasterise(resolved)
    for name in ("normals", "coverage", "base_color", "depth", "object_index"):
        assert torch.equal(getattr(first, name), getattr(again, name)), name
    assert first.backend == again.backend


@pytest.mark.parametrize("count", [1, 3])
def test_pixels_are_the_means_of_their_samples_whatever_adds_them_up(kernel: str, count: int) -> None:  # noqa: ARG001
    random = torch.Generator().manual_seed(count)
    height, width = 5, 7
    number = torch.randint(0, count + 1, (height * FACTOR, width * FACTOR), generator=random)
    number[:FACTOR, :FACTOR] = 0
    number[:FACTOR, FACTOR : 2 * FACTOR] = count
    seen = (number > 0)[..., None]
    geometry = torch.randn(*number.shape, 4, generator=random) * seen
    surface = torch.cat([torch.rand(*number.shape, 3, generator=random) * seen, number[..., None]], dim=-1)
    found = gbuffer.average_samples(geometry, surface, count, np.array([0.0, 0.0, -1.0]))
    for row, column in np.ndindex(height, width):
        block = (slice(FACTOR * row, FACTOR * row + FACTOR), slice(FACTOR * column, FACTOR * column + FACTOR))
        numbers, shapes_, looks = number[block], geometry[block].double(), surface[block].double()
        votes = torch.bincount(numbers.flatten(), minlength=count + 1)[1:]
        assert float(found["coverage"][row, column]) == int(votes.sum()) / FACTOR**2
        if not votes.any():
            assert int(found["object_index"][row, column]) == -1
            for name in ("normals", "base_color", "depth"):
                assert not found[name][row, column].any(), name
            continue
        owner = int(votes.argmax())
        own, any_ = numbers == owner + 1, numbers > 0
        assert int(found["object_index"][row, column]) == owner
        close = {"rtol": 0, "atol": 3e-6}  # sixteen float32 values of order 1
        depth = float(found["depth"][row, column])
        torch.testing.assert_close(depth, float(shapes_[..., 3][own].mean()), **close)
        torch.testing.assert_close(found["base_color"][row, column].double(), looks[..., :3][any_].mean(0), **close)
        normal = shapes_[..., :3][any_].sum(0)
        torch.testing.assert_close(found["normals"][row, column].double(), normal / normal.norm(), **close)
