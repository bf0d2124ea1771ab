"""Linear radiance against closed forms in float64: planes, spheres, sheets, glass; and its linearity in the lights."""

from math import pi

import numpy as np
import pytest
import torch

from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight
from tests.unit.rendering import shapes
from tests.unit.rendering.pyrender.closed_form import ambient_coat, body_and_coat, plane, sky
from tests.unit.rendering.pyrender.parameter_batches import batch_of_one
from tests.unit.rendering.shapes import mesh, part, placed, quad, scene, sphere

pytestmark = pytest.mark.slow

LIGHTS = Lights(ambient=0.3, points=(PointLight(energy=12.0, position=(0.5, 0.8, 1.4)),))


def test_a_plane_has_the_radiance_of_its_closed_form() -> None:
    description = scene((40, 60), lights=LIGHTS, azimuth=0.4, elevation=0.3)
    points, normal, eye = plane(description)
    body, coat = body_and_coat(points, normal, eye, LIGHTS.points[0].position)
    color = np.array([0.2, 0.5, 0.8])
    renderer = PyrenderRenderer(placed(description, mesh(quad(9.0, color=(*color, 1)))))
    image = renderer.radiance({})[0].numpy()
    expected = (0.3 + 12 * body)[..., None] * color + (0.3 * ambient_coat(normal, points, eye) + 12 * coat)[..., None]
    # float32 positions of pixels of a large triangle are good to about 1e-4.
    np.testing.assert_allclose(image[..., :3], expected, rtol=3e-4)
    assert (image[..., 3] == 1).all()
    assert 0.1 < (12 * coat).max() / expected.max() < 0.6  # the coat is there to be seen, and modest
    # Lambert alone: white minus black, n.l / d^2 * E / pi.
    black, white = (
        renderer.radiance(batch_of_one(renderer, color=torch.full((1, 3), c)))[0].numpy() for c in (0.0, 1.0)
    )
    np.testing.assert_allclose((white - black)[..., 1], 0.5 * (0.3 + 12 * body), rtol=3e-4)


def test_a_sphere_has_the_radiance_of_its_closed_form() -> None:
    side = Lights(ambient=0.3, points=(PointLight(energy=12, position=(1.4, 0.8, -0.3)),))
    description = scene((120, 120), lights=side, azimuth=0.61, elevation=0.35)
    eye, ray = shapes.rays(description.camera)
    a, b, c = (ray * ray).sum(-1), ray @ eye, eye @ eye - 0.25
    hit = b * b - a * c > 0.04  # away from the rim, where a pixel sees a range of normals
    points = eye + ((-b - np.sqrt(np.where(hit, b * b - a * c, 0))) / a)[..., None] * ray
    normals = points * 2
    body, coat = body_and_coat(points, normals, eye, side.points[0].position)
    expected = (0.3 * sky(normals[..., 1]) + 0.3 * ambient_coat(normals, points, eye) + 12 * (body + coat))[hit]
    image = PyrenderRenderer(placed(description, mesh(sphere(0.5, 192)))).radiance({})[0, ..., 0].numpy()[hit]
    # Where an edge of triangles crosses a pixel, each side is shaded up to a quarter pixel from the middle: errors of
    # 1e-2 that cancel in the mean (measured: half at half the edge length).
    assert np.abs(image / expected - 1).max() < 2e-2
    assert np.abs(image / expected - 1).mean() < 2e-3
    assert 0.2 < (body[hit] == 0).mean() < 0.6  # part of it faces away from the light


def test_both_sides_of_a_sheet_are_lit_alike() -> None:
    lights = [Lights(ambient=0, points=(PointLight(energy=9, position=(0.3, 0.4, z)),)) for z in (1.5, -1.5)]
    front = PyrenderRenderer(placed(scene(lights=lights[0]), mesh(quad(0.5)))).radiance({})[0]
    back = PyrenderRenderer(placed(scene(lights=lights[1], azimuth=pi), mesh(quad(0.5)))).radiance({})[0]
    torch.testing.assert_close(front, back.flip(1), rtol=1e-4, atol=1e-5)
    shadow = PyrenderRenderer(placed(scene(lights=lights[1]), mesh(quad(0.5)))).radiance({})[0]
    assert shadow[..., :3].max() == 0  # lit from behind, seen from the front


def test_radiance_is_linear_in_ambient_and_in_each_energy_and_goes_beyond_white() -> None:
    lights = Lights(ambient=0.2, points=(PointLight(position=(1, 1, 2)), PointLight(position=(-2, 0, 1))))
    renderer = PyrenderRenderer(placed(scene(lights=lights), mesh(sphere(0.5, color=(0.9, 0.6, 0.3, 1)))))
    start = renderer.initial()["illumination"]

    def radiance(*magnitudes: float) -> torch.Tensor:
        value = start.clone()
        value[[0, 1, 5]] = torch.tensor(magnitudes, dtype=torch.float64)
        return renderer.radiance(batch_of_one(renderer, illumination=value))[0, ..., :3]

    parts = [radiance(1, 0, 0), radiance(0, 1, 0), radiance(0, 0, 1)]
    whole = radiance(0.7, 8.0, 3.0)
    assert whole.max() > 10
    torch.testing.assert_close(whole, 0.7 * parts[0] + 8 * parts[1] + 3 * parts[2], rtol=1e-5, atol=1e-6)


def test_glass_is_blended_in_the_order_of_distance() -> None:
    dark = Lights(ambient=1.0, points=())
    wall = quad(3.0, color=(0, 0, 1, 1), centre=(0, 0, -0.5))
    panes = quad(0.4, color=(1, 0, 0, 0.5), centre=(0, 0, 0.1)), quad(0.4, color=(0, 1, 0, 0.5), centre=(0, 0, 0.3))
    for order in (panes, panes[::-1]):
        renderer = PyrenderRenderer(placed(scene((32, 32), lights=dark), mesh(*order, wall)))
        # Green over red over blue, each by half; every coat reflects 0.04, seen through what is before it.
        gloss = 0.04 * (1 + 1 / 2 + 1 / 4)
        expected = [0.25 + gloss, 0.5 + gloss, 0.25 + gloss, 1]
        np.testing.assert_allclose(renderer.radiance({})[0, 16, 16], expected, atol=1e-5)
    alone = PyrenderRenderer(placed(scene((32, 32), lights=dark), mesh(panes[0])))
    np.testing.assert_allclose(alone.radiance({})[0, 16, 16], [0.54, 0.04, 0.04, 0.5], atol=1e-5)


def test_zero_normals_fall_back_to_the_face_normal() -> None:
    flat = quad(0.5)
    bare = part(flat.vertices, flat.faces, np.zeros((4, 3)))
    results = [PyrenderRenderer(placed(scene((24, 24)), mesh(p))).radiance({}) for p in (flat, bare)]
    torch.testing.assert_close(*results, rtol=1e-3, atol=1e-5)
