from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from services.errors import JobFailure
from services.rendering.color import as_saved, to_display
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.pyrender_renderer.parameters import ENERGY
from services.rendering.pyrender_renderer.renderer import EXPOSURE, PyrenderRenderer
from services.scenes.description import GROUND, Lights, PointLight, Scene, SceneObject
from tests.unit.rendering import shapes
from tests.unit.rendering.shapes import disk, mesh, part, placed, quad, scene, sphere

LIGHTS = Lights(ambient=0.3, points=(PointLight(energy=12.0, position=(0.5, 0.8, 1.4)),))


def one(renderer: PyrenderRenderer, **changes: torch.Tensor) -> dict[str, torch.Tensor]:
    """The scene's own parameters with a batch dimension, some replaced."""
    return {group: changes.get(group, value)[None] for group, value in renderer.initial().items()}


def body_and_coat(
    points: np.ndarray, normals: np.ndarray, eye: np.ndarray, light: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance for one unit of energy of a white Lambertian body, n.l / (pi d^2), and of the coat, in float64.

    The coat is GGX with alpha = 0.45^2 and normal reflectance 0.04, written from Walter et al. 2007 (D, and G as the
    height-correlated Smith form of Heitz 2014) and Schlick 1994.
    """
    to_light, to_eye = np.array(light) - points, eye - points
    distance = np.linalg.norm(to_light, axis=-1)
    l, v = to_light / distance[..., None], to_eye / np.linalg.norm(to_eye, axis=-1)[..., None]
    h = (l + v) / np.linalg.norm(l + v, axis=-1)[..., None]
    nl, nv, nh, vh = ((a * b).sum(-1) for a, b in ((normals, l), (normals, v), (normals, h), (v, h)))
    nl = np.maximum(nl, 0)
    alpha2 = 0.45**4
    tan2 = (1 - nh**2) / nh**2
    d = alpha2 / (pi * nh**4 * (alpha2 + tan2) ** 2)
    smith = [(np.sqrt(1 + alpha2 * (1 - c**2) / np.maximum(c, 1e-6) ** 2) - 1) / 2 for c in (nl, nv)]
    g = 1 / (1 + smith[0] + smith[1])
    f = 0.04 + 0.96 * (1 - vh) ** 5
    coat = d * g * f / (4 * np.maximum(nl, 1e-6) * np.maximum(nv, 1e-6))
    return nl / distance**2 / pi, coat * nl / distance**2


def sky(up: np.ndarray | float) -> np.ndarray:
    """Irradiance / pi per unit of ambient light: a sky half as bright again above, half as dim below, 1 + 0.5 y."""
    return 1 + np.asarray(up) / 3


def ambient_coat(normals: np.ndarray, points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Ambient light the coat reflects: Schlick's term, its rise damped by the roughness of 0.45."""
    v = (eye - points) / np.linalg.norm(eye - points, axis=-1)[..., None]
    return 0.04 + (0.55 - 0.04) * (1 - np.maximum((normals * v).sum(-1), 0)) ** 5


def plane(description: Scene) -> tuple[np.ndarray, ...]:
    """Points, normals and eye of the plane z = 0 as the camera sees it."""
    eye, ray = shapes.rays(description.camera)
    return eye + ray * (-eye[2] / ray[..., 2])[..., None], np.array([0.0, 0.0, 1.0]), eye


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
    black, white = (renderer.radiance(one(renderer, color=torch.full((1, 3), c)))[0].numpy() for c in (0.0, 1.0))
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
    assert 0.2 < (body[hit] == 0).mean() < 0.6  # part of it is in its own shade


def test_a_sheet_is_lit_on_both_sides_alike() -> None:
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
        return renderer.radiance(one(renderer, illumination=value))[0, ..., :3]

    parts = [radiance(1, 0, 0), radiance(0, 1, 0), radiance(0, 0, 1)]
    whole = radiance(0.7, 8.0, 3.0)
    assert whole.max() > 10
    torch.testing.assert_close(whole, 0.7 * parts[0] + 8 * parts[1] + 3 * parts[2], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("delta", [1e-3, 1e-3 / ENERGY])
def test_float_images_follow_the_derivative_in_energy_and_eight_bits_do_not(delta: float) -> None:
    """d image / d energy is exact: radiance is linear in energy, and the slope of the display curve is known."""
    dim = Lights(ambient=0.3, points=(PointLight(energy=5.0, position=(0.5, 0.8, 1.4)),))
    description = scene((48, 64), lights=dim, azimuth=0.4, elevation=0.3)
    points, normal, eye = plane(description)
    body, coat = body_and_coat(points, normal, eye, dim.points[0].position)
    color = np.array([0.2, 0.5, 0.8])
    slope = ENERGY * EXPOSURE * (body[..., None] * color + coat[..., None])
    ambient = 0.3 * (color + ambient_coat(normal, points, eye)[..., None])
    linear = EXPOSURE * ambient + slope * 5 / ENERGY
    assert (linear < 1).all()  # not clipped anywhere
    assert (linear > 0.0031308).all()  # on the power branch of the curve
    exact = slope * 1.055 / 2.4 * linear ** (1 / 2.4 - 1)

    renderer = PyrenderRenderer(placed(description, mesh(quad(9.0, color=(*color, 1)))))
    step = torch.zeros(5, dtype=torch.float64)
    step[1] = delta
    start = renderer.initial()["illumination"]
    up, down = renderer.render({"illumination": torch.stack([start + step, start - step])})

    def error(difference: torch.Tensor) -> float:
        return float(np.linalg.norm(difference.double().numpy() / (2 * delta) - exact) / np.linalg.norm(exact))

    assert error(up - down) < 0.01
    assert error(as_saved(up) - as_saved(down)) > 0.5  # the same on what is saved: rounding drowns the change


def test_the_image_is_displayed_radiance_over_the_displayed_ground() -> None:
    description = scene((48, 48)).model_copy(update={"ground": (0.2, 0.4, 0.6)})
    renderer = PyrenderRenderer(placed(description, mesh(sphere(0.5, color=(0.5, 0.4, 0.3, 1)))))
    radiance, image = renderer.radiance({})[0], renderer.render({})[0]
    coverage = radiance[..., 3:]
    surface = to_display(EXPOSURE * radiance[..., :3] / coverage.clamp_min(1e-6))
    ground = torch.tensor([0.2, 0.4, 0.6])
    torch.testing.assert_close(image, coverage * surface + (1 - coverage) * ground, rtol=0, atol=1e-6)
    assert torch.equal(image[0, 0], ground)
    assert ((coverage > 0) & (coverage < 1)).sum() > 50  # silhouettes are anti-aliased
    assert image.dtype == torch.float32
    assert image.min() >= 0
    assert image.max() <= 1


def test_the_default_light_exposes_white_and_grey_well() -> None:
    for color, low, high in ((1.0, 0.6, 0.97), (0.2, 0.3, 0.7)):
        description = scene((96, 96), azimuth=0.61, elevation=0.35)
        renderer = PyrenderRenderer(placed(description, mesh(sphere(0.5, color=(color,) * 3 + (1,)))))
        image, coverage = renderer.render({})[0, ..., 0], renderer.radiance({})[0, ..., 3]
        inside = image[coverage == 1]
        assert low < inside.mean() < high
        assert (inside == 1).float().mean() < 0.1


def test_initial_parameters_are_the_scene() -> None:
    things = (
        SceneObject(mesh="primitive/a", color=(0.9, 0.5, 0.1), translation=(-0.3, 0.1, 0.2), rotation=(0.3, 0.5, -0.4)),
        SceneObject(mesh="primitive/b", translation=(0.4, -0.2, 0), scale=0.5),
    )
    lights = Lights(ambient=0.25, points=(PointLight(energy=15, position=(1, 2, 3)), PointLight(energy=6)))
    description = scene((80, 100), azimuth=0.7, elevation=0.2).model_copy(update={"objects": things, "lights": lights})
    resolved = placed(description, shapes.six_parts(), mesh(sphere(0.5)))
    renderer = PyrenderRenderer(resolved)
    initial = renderer.initial()
    assert initial["illumination"].tolist() == [0.25, 0.5, 1, 2, 3, 0.2, 1.2, 2.0, 1.5]
    assert [list(initial[g].shape) for g in renderer.groups] == [[9], [2, 3], [2, 3], [2, 3]]
    assert [len(renderer.names(g) or []) for g in renderer.groups] == [9, 6, 6, 6]
    assert torch.equal(renderer.render({}), renderer.render(one(renderer)))
    # The same poses as the model matrices, through the G-buffer: both sample silhouettes, 4 and 16 times a pixel.
    difference = renderer.radiance({})[0, ..., 3] - rasterise(resolved).coverage
    assert difference.abs().max() <= 0.5
    assert difference.abs().mean() < 5e-3


def test_a_posed_object_looks_like_a_mesh_with_the_pose_baked_in() -> None:
    base = scene((80, 80), azimuth=0.7, elevation=0.2)
    pose = SceneObject(mesh="primitive/a", translation=(0.1, -0.1, 0.2), rotation=(0.3, 0.8, -0.4), scale=0.6)
    turn = Rotation.from_rotvec(pose.rotation)
    baked = [
        replace(
            p,
            vertices=(0.6 * turn.apply(p.vertices) + pose.translation).astype(np.float32),
            normals=turn.apply(p.normals).astype(np.float32),
        )
        for p in shapes.six_parts().parts
    ]
    scenes = placed(base.model_copy(update={"objects": (pose,)}), shapes.six_parts()), placed(base, mesh(*baked))
    posed, still = (PyrenderRenderer(s).radiance({})[0] for s in scenes)
    # Rounding may move a sample over an edge; elsewhere float32 positions differ in the last bits.
    assert ((posed - still).abs() > 1e-3).float().mean() < 1e-3
    normals = [rasterise(s).normals for s in scenes]
    assert ((normals[0] - normals[1]).abs() > 1e-3).float().mean() < 1e-3


def test_one_object_and_one_light_make_the_papers_fourteen_numbers() -> None:
    renderer = PyrenderRenderer(placed(scene(), mesh(sphere(0.5))))
    assert sum(value.numel() for value in renderer.initial().values()) == 14
    assert renderer.names("illumination") == ["ambient", "point 0 energy", "point 0 x", "point 0 y", "point 0 z"]
    bounds = renderer.bounds()
    assert bounds["illumination"][0].tolist() == [0, 0, -inf, -inf, -inf]
    assert [b.item() for b in bounds["color"]] == [0, 1]
    assert set(bounds) == set(renderer.groups)


def test_objects_move_the_way_they_are_told() -> None:
    renderer = PyrenderRenderer(placed(scene((101, 101)), mesh(disk(0.1, 64))))
    rows, columns = torch.meshgrid(torch.arange(101.0), torch.arange(101.0), indexing="ij")

    def seen(group: str, *value: float) -> tuple[float, float, float]:
        """Row, column and size of what is covered."""
        coverage = renderer.radiance(one(renderer, **{group: torch.tensor([value])}))[0, ..., 3]
        area = coverage.sum().item()
        return (coverage * rows).sum().item() / area, (coverage * columns).sum().item() / area, area

    row, column, area = seen("translation", 0, 0, 0)
    assert (row, column) == pytest.approx((50, 50), abs=0.05)
    moved = seen("translation", 0.1, 0, 0)
    # 0.1 to the right at distance 1.8 is 0.1 / 1.8 / tan(fov / 2) * 101 / 2 = 6.14 pixels.
    assert moved[:2] == pytest.approx((row, column + 6.14), abs=0.15)
    assert seen("translation", 0, 0.1, 0)[:2] == pytest.approx((row - 6.14, column), abs=0.15)
    assert seen("translation", 0, 0, 0.3)[2] > 1.3 * area

    far = mesh(quad(0.05, centre=(0, 0, 0.4)))
    renderer = PyrenderRenderer(placed(scene((101, 101)), far))
    assert seen("rotation", 0, 0.5, 0)[1] > 55  # +z turns towards +x about +y: right
    assert seen("rotation", 0.5, 0, 0)[0] > 55  # +z turns towards -y about +x: down
    turned = mesh(quad(0.05, centre=(0.4, 0, 0)))
    renderer = PyrenderRenderer(placed(scene((101, 101)), turned))
    assert seen("rotation", 0, 0, 0.5)[0] < 45  # +x turns towards +y about +z: up


def test_colour_changes_only_its_own_channel_and_object() -> None:
    description = scene((40, 80), objects=2)
    left, right = mesh(quad(0.3, centre=(-0.6, 0, 0))), mesh(quad(0.3, centre=(0.6, 0, 0)))
    renderer = PyrenderRenderer(placed(description, left, right))
    color = renderer.initial()["color"]
    color[1, 1] = 0.5
    change = (renderer.render(one(renderer, color=color)) - renderer.render({}))[0].abs().sum((0,))
    assert change[:40].max() == 0
    assert (change[40:].sum(0) > 0).tolist() == [False, True, False]
    # Beyond 1 and below 0 nothing is clamped: differences at the bound are of the same size on both sides.
    above, at, below = (renderer.radiance(one(renderer, color=color * 0 + 1 + d))[0, 20, 20, 0] for d in (0.1, 0, -0.1))
    assert (above - at).item() == pytest.approx((at - below).item(), rel=1e-4)


def test_an_object_pushed_out_of_the_frame_leaves_the_ground() -> None:
    renderer = PyrenderRenderer(placed(scene((16, 16)), mesh(sphere(0.5))))
    away = renderer.render(one(renderer, translation=torch.tensor([[50.0, 0.0, 0.0]])))
    assert (away == torch.tensor(GROUND)).all()


def test_glass_shows_what_is_behind_it_in_the_order_of_distance() -> None:
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


def test_an_image_does_not_depend_on_its_batch_nor_on_what_was_drawn_before() -> None:
    renderer = PyrenderRenderer(placed(scene((40, 50), azimuth=0.3), shapes.six_parts()))
    generator = torch.Generator().manual_seed(0)
    batch = {
        group: value + 0.1 * torch.randn((4, *value.shape), generator=generator, dtype=torch.float64)
        for group, value in renderer.initial().items()
    }
    together = renderer.render(batch)
    other = PyrenderRenderer(placed(scene((20, 20)), mesh(sphere(0.3))))
    for i in (2, 0, 3, 1):
        other.render({})
        assert torch.equal(renderer.render({g: v[i : i + 1] for g, v in batch.items()})[0], together[i])


def test_bad_parameters_are_refused() -> None:
    renderer = PyrenderRenderer(placed(scene((8, 8)), mesh(sphere(0.5))))
    bad = one(renderer, rotation=torch.tensor([[0.0, float("nan"), 0.0]]))
    with pytest.raises(JobFailure, match="rotation") as caught:
        renderer.render(bad)
    assert caught.value.kind == "non-finite"
    bright = renderer.initial()["illumination"]
    bright[1] = 1e38
    with pytest.raises(JobFailure, match="not finite: light"):
        renderer.render(one(renderer, illumination=bright))
    with pytest.raises(ValueError, match="no group 'normals'"):
        renderer.render({"normals": torch.zeros(1, 3)})
    with pytest.raises(ValueError, match=r"color is \[1, 3\], not \[B, \*\[1, 3\]\]"):
        renderer.render({"color": torch.zeros(1, 3)})
    with pytest.raises(ValueError, match="different sizes"):
        renderer.render({"color": torch.zeros(2, 1, 3), "rotation": torch.zeros(3, 1, 3)})


def test_zero_normals_fall_back_to_the_flat_triangle() -> None:
    flat = quad(0.5)
    bare = part(flat.vertices, flat.faces, np.zeros((4, 3)))
    results = [PyrenderRenderer(placed(scene((24, 24)), mesh(p))).radiance({}) for p in (flat, bare)]
    torch.testing.assert_close(*results, rtol=1e-3, atol=1e-5)
