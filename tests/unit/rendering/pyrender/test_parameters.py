"""Parameter groups of the pyrender renderer: initial values, what each coordinate does, what is refused."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from scene_attack.errors import JobFailure
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import GROUND, Lights, PointLight, SceneObject
from tests.unit.rendering import shapes
from tests.unit.rendering.pyrender.parameter_batches import batch_of_one
from tests.unit.rendering.shapes import disk, mesh, placed, quad, scene, sphere

pytestmark = pytest.mark.slow


def test_initial_parameters_are_those_of_the_scene() -> None:
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
    assert [list(initial[g].shape) for g in renderer.groups] == [[9], [2, 3], [2, 3], [2, 3], [4]]
    assert [len(renderer.names(g) or []) for g in renderer.groups] == [9, 6, 6, 6, 4]
    assert torch.equal(renderer.render({}), renderer.render(batch_of_one(renderer)))
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


def test_one_object_and_one_light_have_the_papers_fourteen_parameters() -> None:
    renderer = PyrenderRenderer(placed(scene(), mesh(sphere(0.5))))
    assert sum(renderer.initial()[group].numel() for group in PYRENDER.default_groups) == 14
    assert renderer.names("illumination") == ["ambient", "point 0 energy", "point 0 x", "point 0 y", "point 0 z"]
    bounds = renderer.bounds()
    assert bounds["illumination"][0].tolist() == [0, 0, -inf, -inf, -inf]
    assert [b.item() for b in bounds["color"]] == [0, 1]
    assert set(bounds) == set(renderer.groups)


def test_objects_move_and_turn_in_the_directions_of_the_axes() -> None:
    renderer = PyrenderRenderer(placed(scene((101, 101)), mesh(disk(0.1, 64))))
    rows, columns = torch.meshgrid(torch.arange(101.0), torch.arange(101.0), indexing="ij")

    def covered(group: str, *value: float) -> tuple[float, float, float]:
        """Mean row, mean column and number of the covered pixels."""
        coverage = renderer.radiance(batch_of_one(renderer, **{group: torch.tensor([value])}))[0, ..., 3]
        area = coverage.sum().item()
        return (coverage * rows).sum().item() / area, (coverage * columns).sum().item() / area, area

    row, column, area = covered("translation", 0, 0, 0)
    assert (row, column) == pytest.approx((50, 50), abs=0.05)
    moved = covered("translation", 0.1, 0, 0)
    # 0.1 to the right at distance 1.8 is 0.1 / 1.8 / tan(fov / 2) * 101 / 2 = 6.14 pixels.
    assert moved[:2] == pytest.approx((row, column + 6.14), abs=0.15)
    assert covered("translation", 0, 0.1, 0)[:2] == pytest.approx((row - 6.14, column), abs=0.15)
    assert covered("translation", 0, 0, 0.3)[2] > 1.3 * area

    far = mesh(quad(0.05, centre=(0, 0, 0.4)))
    renderer = PyrenderRenderer(placed(scene((101, 101)), far))
    assert covered("rotation", 0, 0.5, 0)[1] > 55  # +z turns towards +x about +y: right
    assert covered("rotation", 0.5, 0, 0)[0] > 55  # +z turns towards -y about +x: down
    turned = mesh(quad(0.05, centre=(0.4, 0, 0)))
    renderer = PyrenderRenderer(placed(scene((101, 101)), turned))
    assert covered("rotation", 0, 0, 0.5)[0] < 45  # +x turns towards +y about +z: up


def test_colour_changes_only_its_own_channel_and_object() -> None:
    description = scene((40, 80), objects=2)
    left, right = mesh(quad(0.3, centre=(-0.6, 0, 0))), mesh(quad(0.3, centre=(0.6, 0, 0)))
    renderer = PyrenderRenderer(placed(description, left, right))
    color = renderer.initial()["color"]
    color[1, 1] = 0.5
    change = (renderer.render(batch_of_one(renderer, color=color)) - renderer.render({}))[0].abs().sum((0,))
    assert change[:40].max() == 0
    assert (change[40:].sum(0) > 0).tolist() == [False, True, False]
    # Beyond 1 and below 0 nothing is clamped: differences at the bound are of the same size on both sides.
    above, at, below = (
        renderer.radiance(batch_of_one(renderer, color=color * 0 + 1 + d))[0, 20, 20, 0] for d in (0.1, 0, -0.1)
    )
    assert (above - at).item() == pytest.approx((at - below).item(), rel=1e-4)


def test_without_an_object_in_the_frame_the_image_is_the_ground() -> None:
    renderer = PyrenderRenderer(placed(scene((16, 16)), mesh(sphere(0.5))))
    away = renderer.render(batch_of_one(renderer, translation=torch.tensor([[50.0, 0.0, 0.0]])))
    assert (away == torch.tensor(GROUND)).all()


def test_an_image_does_not_depend_on_its_batch_nor_on_earlier_images() -> None:
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
    bad = batch_of_one(renderer, rotation=torch.tensor([[0.0, float("nan"), 0.0]]))
    with pytest.raises(JobFailure, match="rotation") as caught:
        renderer.render(bad)
    assert caught.value.kind == "non-finite"
    bright = renderer.initial()["illumination"]
    bright[1] = 1e38
    with pytest.raises(JobFailure, match="not finite: light"):
        renderer.render(batch_of_one(renderer, illumination=bright))
    with pytest.raises(ValueError, match="no group 'normals'"):
        renderer.render({"normals": torch.zeros(1, 3)})
    with pytest.raises(ValueError, match=r"color is \[1, 3\], not \[B, \*\[1, 3\]\]"):
        renderer.render({"color": torch.zeros(1, 3)})
    with pytest.raises(ValueError, match="different sizes"):
        renderer.render({"color": torch.zeros(2, 1, 3), "rotation": torch.zeros(3, 1, 3)})
