"""Directional and spot lights, and the coordinates of all lights in the group `illumination`."""

from math import cos, pi

import numpy as np
import pytest
import torch

from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.planner import inactive_coordinates
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import DirectionalLight, Lights, PointLight, SpotLight
from tests.unit.rendering import shapes
from tests.unit.rendering.shapes import mesh, placed, quad, scene, sphere

FAR = 2000.0
AIM = np.array([0.4, -0.5, -1.0])


def renderer(lights: Lights, size: tuple[int, int] = (32, 40), **camera: float) -> PyrenderRenderer:
    return PyrenderRenderer(placed(scene(size, lights=lights, **camera), mesh(sphere(0.5, color=(0.8, 0.6, 0.4, 1)))))


def radiance(lights: Lights) -> np.ndarray:
    return renderer(lights).radiance({})[0].double().numpy()


def test_one_object_and_one_point_light_are_the_paper_s_numbers() -> None:
    subject = renderer(Lights(ambient=0.2, points=(PointLight(energy=15.0, position=(1.0, 2.0, 3.0)),)))
    start = subject.initial()
    assert sum(start[group].numel() for group in PYRENDER.default_groups) == 14
    assert subject.names("illumination") == ["ambient", "point 0 energy", "point 0 x", "point 0 y", "point 0 z"]
    assert start["illumination"].tolist() == [0.2, 0.5, 1.0, 2.0, 3.0]


def test_all_lights_are_coordinates_with_names_units_and_bounds() -> None:
    lights = Lights(
        ambient=0.2,
        points=(PointLight(energy=15.0, position=(1.0, 2.0, 3.0)),),
        directional=(DirectionalLight(energy=6.0, direction=(0.0, -2.0, 0.0)),),
        spots=(SpotLight(energy=60.0, position=(3.0, 2.0, 1.0), direction=(0.0, 0.0, -5.0)),),
    )
    subject = renderer(lights)
    assert subject.names("illumination") == [
        "ambient",
        *(f"point 0 {name}" for name in ("energy", "x", "y", "z")),
        *(f"directional 0 {name}" for name in ("energy", "direction x", "direction y", "direction z")),
        *(f"spot 0 {name}" for name in ("energy", "x", "y", "z", "direction x", "direction y", "direction z")),
    ]
    values = subject.initial()["illumination"].tolist()
    assert values == [0.2, 0.5, 1, 2, 3, 2, 0, -1, 0, 2, 3, 2, 1, 0, 0, -1]
    low, _ = subject.bounds()["illumination"]
    assert (low == 0).nonzero()[:, 0].tolist() == [0, 1, 5, 9]


def test_a_directional_light_is_a_point_light_far_away() -> None:
    unit = AIM / np.linalg.norm(AIM)
    sun = DirectionalLight(energy=4.0, direction=tuple(AIM * 3))
    near = radiance(Lights(ambient=0.1, points=(), directional=(sun,)))
    subject = renderer(Lights(ambient=0.1, points=(PointLight(),)))
    far = torch.tensor([[0.1, 4.0 * FAR**2 / 30, *(-unit * FAR)]], dtype=torch.float64)
    point = subject.radiance({"illumination": far})[0].double().numpy()
    # The point light's direction turns by 0.5 / FAR across the sphere.
    np.testing.assert_allclose(near, point, rtol=2e-3, atol=2e-3)
    assert near[..., 0].max() > 0.5


@pytest.mark.parametrize(("inner", "outer"), [(0.0, 0.4), (0.15, 0.3)])
def test_a_spot_light_is_a_point_light_within_its_cone(inner: float, outer: float) -> None:
    place = (0.3, 0.6, 2.0)
    spot = SpotLight(
        energy=8.0, position=place, direction=tuple(-np.array(place)), inner_angle=inner, outer_angle=outer
    )
    description = scene((48, 48), lights=Lights(ambient=0, points=(), spots=(spot,)))
    found = PyrenderRenderer(placed(description, mesh(quad(9.0)))).radiance({})[0].double().numpy()
    point = Lights(ambient=0, points=(PointLight(energy=8.0, position=place),))
    whole = PyrenderRenderer(placed(scene((48, 48), lights=point), mesh(quad(9.0)))).radiance({})[0].double().numpy()
    eye, ray = shapes.rays(description.camera)
    points = eye + ray * (-eye[2] / ray[..., 2])[..., None]
    away = points - np.array(place)
    angle = np.arccos(np.clip(away @ -np.array(place) / np.linalg.norm(away, axis=-1) / np.linalg.norm(place), -1, 1))
    share = np.clip((np.cos(angle) - cos(outer)) / (cos(inner) - cos(outer)), 0, 1) ** 2
    np.testing.assert_allclose(found[..., :3], share[..., None] * whole[..., :3], rtol=2e-3, atol=2e-4)
    assert (share == 0).any()
    assert share.max() > 0.5


def test_only_the_direction_of_a_direction_counts() -> None:
    subject = renderer(Lights(ambient=0, points=(), directional=(DirectionalLight(),), spots=(SpotLight(),)))
    start = subject.initial()["illumination"]
    longer, none = start.clone(), start.clone()
    longer[2:5] *= 3
    longer[9:12] *= 3
    none[2:5] = 0
    none[9:12] = 0
    first, second, dark = subject.radiance({"illumination": torch.stack([start, longer, none])})
    torch.testing.assert_close(first, second, rtol=1e-5, atol=1e-6)
    assert first[..., 0].max() > 0.1
    assert dark[..., :3].max() == 0


def test_radiance_is_linear_in_every_energy() -> None:
    subject = renderer(Lights(directional=(DirectionalLight(),), spots=(SpotLight(outer_angle=pi / 2),)))
    start = subject.initial()["illumination"]
    energies = [0, 1, 5, 9]
    assert [subject.names("illumination")[k].split()[-1] for k in energies] == ["ambient", "energy", "energy", "energy"]
    alone = torch.zeros(4, len(start), dtype=torch.float64) + start
    alone[:, energies] = torch.eye(4, dtype=torch.float64)
    whole = start.clone()
    whole[energies] = torch.tensor([0.7, 2.0, 3.0, 0.5], dtype=torch.float64)
    parts = subject.radiance({"illumination": alone})[..., :3]
    assert (parts.amax(dim=(1, 2, 3)) > 0.1).all()
    found = subject.radiance({"illumination": whole[None]})[0, ..., :3]
    expected = (parts * torch.tensor([0.7, 2.0, 3.0, 0.5]).reshape(4, 1, 1, 1)).sum(0)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)


def test_many_lights_share_a_pass_without_a_bit_of_difference() -> None:
    subject = renderer(Lights(directional=(DirectionalLight(),) * 2, spots=(SpotLight(),) * 2))
    start = subject.initial()["illumination"]
    batch = start + torch.linspace(0, 0.2, 6 * len(start), dtype=torch.float64).reshape(6, -1)
    assert torch.equal(subject.radiance({"illumination": batch}), subject.exact().radiance({"illumination": batch}))


def test_a_sun_behind_all_that_is_seen_is_inactive() -> None:
    sun = DirectionalLight(energy=2.0, direction=(0.1, 0.0, 1.0))
    spot = SpotLight(energy=2.0, position=(0.0, 0.0, -3.0), direction=(0.0, 0.0, 1.0))
    description = scene((24, 24), lights=Lights(points=(), directional=(sun,), spots=(spot,)))
    subject = PyrenderRenderer(placed(description, mesh(quad(0.5))))
    found = {one.name for one in inactive_coordinates(subject, {}, {"illumination": 0.1})}
    suns = {
        "directional 0 energy",
        "directional 0 direction x",
        "directional 0 direction y",
        "directional 0 direction z",
    }
    assert suns | {"spot 0 energy"} == {name for name in found if name.startswith(("directional", "spot"))}
    grazing = DirectionalLight(energy=2.0, direction=(1.0, 0.0, 0.05))
    low = scene((24, 24), lights=Lights(points=(), directional=(grazing,)))
    subject = PyrenderRenderer(placed(low, mesh(quad(0.5))))
    found = {one.name for one in inactive_coordinates(subject, {}, {"illumination": 0.1})}
    assert {name for name in found if name.startswith("directional")} == {"directional 0 energy"}
