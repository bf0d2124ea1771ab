"""The views of shadow maps and the lights that they are of, by geometry alone: nothing is drawn."""

import numpy as np
import pytest

from scene_attack.rendering.opengl.camera import CameraMatrices, RenderPass
from scene_attack.rendering.opengl.shadows import (
    GRID,
    MAX_PASS_BYTES,
    PARALLEL,
    SIDES,
    axes_along,
    box_corners,
    casters,
    images_per_pass,
    pass_shadows,
    rounded_box,
    shadow_views,
)
from scene_attack.scenes.description import Lights, PointLight, Scene, SceneObject, Shadows

BOX = np.array([np.where([k & 1, k & 2, k & 4], (0.5, 0.4, 0.3), (-0.2, 0.1, -0.3)) for k in range(8)])
"""Corners of a box, as `box_corners` orders them."""


def test_the_rounded_box_holds_every_corner_and_little_more() -> None:
    """Its steps are at most twice the largest side over GRID, and each end is less than a step off."""
    random = np.random.default_rng(0)
    for _ in range(50):
        corners = [random.uniform(-3, 3, 3) + random.uniform(-1, 1, (8, 3)) for _ in range(3)]
        low, high = rounded_box(corners)
        points = np.concatenate(corners)
        first, last = points.min(axis=0), points.max(axis=0)
        step = 2 * (last - first).max() / GRID
        assert (low <= first).all()
        assert (high >= last).all()
        assert (first - low).max() <= step
        assert (high - last).max() <= step


def test_axes_are_at_right_angles_and_the_last_is_the_direction() -> None:
    """Straight up and down too."""
    for direction in [*np.eye(3), *-np.eye(3), *np.random.default_rng(1).normal(size=(50, 3))]:
        axes = axes_along(direction)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(axes[2], direction / np.linalg.norm(direction), atol=1e-12)


@pytest.mark.parametrize("light", [(0.3, 4.0, 0.5, 1.0), (0.2, 0.9, 0.1, 0.0)], ids=["point", "parallel"])
def test_a_soft_shadow_s_samples_look_no_farther_than_a_map_knows_among_the_casters(light: tuple[float, ...]) -> None:
    """By similar triangles, for what is between the nearest caster and the farthest, with a light of radius 0.2."""
    [view] = shadow_views([BOX], np.array(light))
    receiver, blocker = np.meshgrid(*[np.linspace(view.near, view.far, 40)] * 2)
    gap = np.maximum(receiver - blocker, 0.0)
    reach = 0.2 * gap / view.extent if view.parallel else 0.2 * gap / (receiver * blocker) / view.extent
    assert view.parallel == (light[3] == 0)
    assert reach.max() <= view.spread(0.2) * (1 + 1e-12)
    assert view.spread(0.2) == pytest.approx(2 * view.spread(0.1))


def test_a_map_shows_every_caster() -> None:
    """Of a light at any place: its corners are within one of the views, between their nearest and farthest depth."""
    random = np.random.default_rng(2)
    for _ in range(60):
        light = np.append(random.normal(size=3) * 10 ** random.uniform(-1, 4), float(random.random() < 0.7))
        views = shadow_views([BOX], light)
        held = np.zeros(8, bool)
        for view in views:
            x, y, depth = ((BOX - view.origin) @ view.axes.T).T
            wide = view.extent * (1.0 if view.parallel else depth)
            inside = (np.abs(x) <= wide) & (np.abs(y) <= wide) & (depth > 0)
            if len(views) == 1:
                assert (depth >= view.near * (1 - 1e-9)).all()
                assert (depth <= view.far * (1 + 1e-9)).all()
            held |= inside
        assert held.all()


def test_a_far_light_is_parallel_and_knows_its_distance() -> None:
    """From where its radius over its distance is the angle at which it is seen."""
    low, high = rounded_box([BOX])
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    towards = np.array([1.0, 2.0, 2.0]) / 3
    for distance, parallel in ((0.9 * PARALLEL * radius, False), (1.1 * PARALLEL * radius, True)):
        [view] = shadow_views([BOX], np.append(middle + distance * towards, 1.0))
        assert view.parallel == parallel
        assert view.distance == pytest.approx(distance if parallel else 1.0)
    [sun] = shadow_views([BOX], np.append(towards, 0.0))
    assert sun.distance == 1.0
    np.testing.assert_allclose(sun.axes[2], -towards)


def test_box_corners_know_a_box_from_what_only_has_its_bounds() -> None:
    corners = BOX.T
    [found], [plain] = box_corners([corners])
    np.testing.assert_array_equal(found, BOX)
    assert plain
    [same], [other] = box_corners([np.column_stack([corners, BOX.mean(axis=0)])])
    np.testing.assert_array_equal(same, BOX)
    assert not other


def test_a_ground_casts_no_shadow_but_with_a_light_or_an_object_behind_it() -> None:
    ground = np.array([np.where([k & 1, k & 2, k & 4], (2, 0, 2), (-2, 0, -2)) for k in range(8)], np.float64)
    above, below = np.array([0.5, 3.0, 0.2, 1.0]), np.array([0.5, -3.0, 0.2, 1.0])
    for light in (above, np.array([0.0, 1.0, 0.0, 0.0])):
        assert casters([ground, BOX], [True, False], light) == [1]
    for light in (below, np.array([0.0, -1.0, 0.0, 0.0])):
        assert casters([ground, BOX], [True, False], light) == [0, 1]
    sunk = BOX - (0.0, 0.2, 0.0)
    assert casters([ground, sunk], [True, False], above) == [0, 1]
    assert casters([ground, BOX], [False, False], above) == [0, 1]


def lit(points: int = 0, directional: int = 0, spots: int = 0, images: int = 1) -> RenderPass:
    """A pass of lights alone, each at a place of its own that all images share."""

    def rows(count: int, width: int, first: int) -> np.ndarray:
        own = np.zeros((count, width))
        own[:, 1:4] = first + np.arange(3 * count).reshape(-1, 3)
        return np.tile(own, (images, 1, 1))

    view = CameraMatrices(np.eye(4), np.zeros(3), np.zeros(3))
    return RenderPass(
        view,
        np.zeros((0, 4, 4)),
        (0, 1, 0, 1),
        np.zeros(images),
        rows(points, 4, 10),
        np.zeros((images, 0, 3)),
        rows(directional, 4, 30),
        rows(spots, 9, 50),
    )


def test_points_and_spots_have_a_radius_and_suns_an_angle() -> None:
    found = pass_shadows(lit(1, 1, 1), Shadows(softness=0.3, angle=0.05))
    assert found is not None
    np.testing.assert_array_equal(found.radii, [0.3, 0.05, 0.3])
    np.testing.assert_array_equal(found.lights[:, 3], [1, 0, 1])
    np.testing.assert_array_equal(found.lights[:, 0], [10, 30, 50])
    np.testing.assert_array_equal(found.of, [0, 1, 2])


def test_images_that_agree_in_a_light_share_it() -> None:
    """Lights are counted image by image, kind by kind."""
    found = pass_shadows(lit(2, 1, 0, images=3), Shadows())
    assert found is not None
    np.testing.assert_array_equal(found.of, [0, 1] * 3 + [2] * 3)
    assert pass_shadows(lit(), Shadows()) is None


def test_hard_shadows_take_one_sample() -> None:
    hard, soft = (pass_shadows(lit(1), Shadows(softness=one, samples=9)) for one in (0.0, 0.1))
    assert hard is not None
    assert soft is not None
    assert (hard.samples, soft.samples) == (1, 9)


def test_a_pass_has_as_many_images_as_the_maps_memory_holds() -> None:
    """Six maps of 4 bytes a texel for each light."""

    def scene(shadows: Shadows | None, lights: int) -> Scene:
        own = Lights(points=tuple(PointLight(position=(1, k, 0)) for k in range(lights)))
        return Scene(objects=(SceneObject(mesh="primitive/sphere"),), lights=own, shadows=shadows)

    assert SIDES == 6
    assert images_per_pass(scene(Shadows(resolution=1024), 2)) == MAX_PASS_BYTES // (6 * 2 * 4 * 1024**2) == 10
    assert images_per_pass(scene(Shadows(resolution=4096), 4)) == 1
    assert images_per_pass(scene(None, 4)) > 1000
