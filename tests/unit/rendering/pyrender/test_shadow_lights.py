"""Shadow maps of several lights, of lights far away, and of what casts no shadow; and which of them a plan counts."""

from dataclasses import replace
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.declaration import BuildRequest
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import DirectionalLight, Floor, Lights, PointLight, Shadows, SpotLight
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering import shapes
from tests.unit.rendering.shadow_scenes import CENTRE, RADIUS, ball, ground_points, over_ground, square

HARD = Shadows(softness=0.0, angle=0.0, resolution=256)
PLACE = np.array([1.2, 2.5, 1.0])


def radiance(scene: ResolvedScene, **lights: Any) -> torch.Tensor:
    """Of the scene under these lights alone [H, W], red."""
    lit = scene.description.model_copy(update={"lights": Lights(**{"ambient": 0.0, "points": ()} | lights)})
    found = PyrenderRenderer(replace(scene, description=lit), tolerance="exact").radiance({})
    return found[0, ..., 0].double()


def passing(scene: ResolvedScene, **lights: Any) -> np.ndarray:
    """The share of these lights that each pixel sees [H, W], where they shine."""
    plain = replace(scene, description=scene.description.model_copy(update={"shadows": None}))
    shaded, whole = radiance(scene, **lights), radiance(plain, **lights)
    return torch.where(whole > 0, shaded / whole, torch.nan).numpy()


def test_each_kind_of_light_has_its_own_shadow_in_one_image() -> None:
    """Two lights of each kind from six sides: the image is the sum of those under each alone."""
    kinds: dict[str, Any] = {
        "points": (PointLight(position=(1.2, 2.5, 1.0)), PointLight(position=(-1.5, 2.0, 0.5), energy=12.0)),
        "directional": (DirectionalLight(direction=(1, -2, -1)), DirectionalLight(direction=(0, -1, 1), energy=1.0)),
        "spots": (
            SpotLight(position=(0.0, 2.0, -2.0), direction=(0, -2, 2), outer_angle=1.2),
            SpotLight(position=(2.0, 2.0, 0.0), direction=(-2, -2, 0), outer_angle=1.2, energy=10.0),
        ),
    }
    scene = over_ground(ball(), shadows=HARD, size=(24, 32))
    alone = [radiance(scene, **{kind: (light,)}) for kind, lights in kinds.items() for light in lights]
    torch.testing.assert_close(radiance(scene, **kinds), torch.stack(alone).sum(0), rtol=1e-4, atol=1e-5)
    shadows = [passing(scene, **{kind: (light,)}) < 0.5 for kind, lights in kinds.items() for light in lights]
    assert all(of.sum() > 5 for of in shadows)
    assert all((one != other).sum() > 5 for k, one in enumerate(shadows) for other in shadows[:k])


@pytest.mark.parametrize(
    ("level", "half", "light"),
    [
        (3.0, 0.04 * 3.0, {"directional": (DirectionalLight(direction=(0, -1, 0)),)}),
        (28.0, 0.02 * 28.0 / (30.0 - 28.0), {"points": (PointLight(position=(0.0, 30.0, 0.0)),)}),
    ],
    ids=["sun", "lamp"],
)
def test_the_penumbra_far_below_what_casts_it(level: float, half: float, light: dict[str, Any]) -> None:
    """Below the middle of a small square's edge, many times its size below it: by the circle's segment. `half` is that
    of the penumbra, by similar triangles."""
    scene = over_ground(
        square(level, 0.2, (0.2, 0.0)),  # its edge at x = 0
        shadows=Shadows(angle=0.04, softness=0.02, samples=64),
        size=(144, 192),
        elevation=0.5,
        azimuth=-pi / 2,
        distance=2.0,
    )
    points, _, _ = ground_points(scene)
    u = points[..., 0] / half
    looked = (np.abs(points[..., 2]) < 0.06) & (np.abs(u) < 1.3)
    v = np.clip(u, -1, 1)
    wanted = 0.5 - (v * np.sqrt(1 - v**2) + np.arcsin(v)) / pi
    off = np.abs(passing(scene, **light)[looked] - wanted[looked])
    assert looked.sum() > 30
    assert off.mean() < 0.02
    assert off.max() < 0.08


def test_a_light_far_away_shades_like_a_sun_as_wide() -> None:
    """Of a small ball, so that its rays are taken for parallel: an angle of its radius over its distance."""
    towards = PLACE / np.linalg.norm(PLACE)
    softness, distance = 5.0, 98.0
    scene = over_ground(
        ball(CENTRE, 0.04), shadows=Shadows(softness=softness, angle=softness / distance), size=(96, 128), elevation=1.3
    )
    far = PointLight(position=tuple(CENTRE + distance * towards), energy=10_000)
    one = passing(scene, points=(far,))
    other = passing(scene, directional=(DirectionalLight(direction=tuple(-towards)),))
    assert np.nanmin(other) < 0.8
    assert np.nanmax(np.abs(one - other)) < 0.05


def test_glass_casts_no_shadow() -> None:
    _, thing = ball()
    clear = shapes.mesh(shapes.sphere(RADIUS, color=(1, 1, 1, 0.5)))
    scene = over_ground((clear, thing), shadows=HARD)
    ground = ground_points(scene)[1]
    seen = passing(scene, points=(PointLight(position=tuple(PLACE)),))[ground]
    assert len(seen) > 500
    assert np.abs(seen - 1).max() < 1e-6


def test_the_plan_counts_the_casters_and_maps_of_every_light() -> None:
    lights = Lights(points=(PointLight(position=tuple(PLACE)), PointLight(position=(-1.5, 2.0, 0.5))))
    scene = over_ground(ball(), shadows=Shadows(resolution=64, samples=2), lights=lights, size=(12, 16))
    plan = PyrenderRenderer(scene, tolerance="exact").plan
    [item] = [item for item in plan.items if item.what == "shadow casters"]
    assert (item.kept, item.of) == (2, 4)
    [stage] = [stage for stage in plan.stages if stage.name == "shadow maps"]
    assert stage.evaluations == 2 * 64**2
    assert stage.method.startswith("2 maps of 64 × 64 texels for 2 lights")


def test_objects_that_a_floor_hides_are_refused() -> None:
    scene = over_ground(size=(12, 16))
    buried = scene.description.model_copy(update={"floor": Floor(size=10.0, height=0.3)})
    with pytest.raises(InvalidRequest, match="no object covers") as refused:
        PyrenderRenderer.build(BuildRequest(replace(scene, description=buried), ("color",), 1e-3, None))
    assert refused.value.field == "scene.objects"


@pytest.mark.usefixtures("software_opengl")
def test_fine_maps_have_a_place_after_many_coarse_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch has a small map for each of 48 places of lights. As many of the finest would take 3 GiB."""
    monkeypatch.setattr(compiled, "library", lambda: None)
    places = [(1.2, 2.5, 1.0), (-1.2, 2.5, 1.0), (1.2, 2.5, -1.0), (-1.2, 2.5, -1.0)]
    lights = Lights(points=tuple(PointLight(position=place) for place in places))
    scene = over_ground(ball(), shadows=HARD.model_copy(update={"resolution": 64}), size=(24, 32))
    renderer = PyrenderRenderer(replace(scene, description=scene.description.model_copy(update={"lights": lights})))
    assert not renderer.rasterises
    illuminations = renderer.initial()["illumination"].repeat(12, 1) + torch.linspace(0, 0.1, 12)[:, None]
    assert renderer.render({"illumination": illuminations}).shape[0] == 12
    finest = over_ground(ball(), shadows=HARD.model_copy(update={"resolution": 4096}), size=(24, 32))
    assert np.nanmin(passing(finest, points=(PointLight(position=(1.2, 2.5, 1.0)),))) == 0.0


def test_the_finer_maps_of_a_plan_fit_into_memory_as_the_scenes_own_do() -> None:
    """Eight lights among the objects, each with six maps: of 4,096 texels a side they would take 3 GiB."""
    around = [(0.3 * cos(k), 0.9, 0.3 * sin(k)) for k in range(8)]
    points = tuple(PointLight(position=place) for place in around[:4])
    spots = tuple(SpotLight(position=place, direction=(0, -1, 0), outer_angle=1.5) for place in around[4:])
    scene = over_ground(ball(), shadows=HARD.model_copy(update={"resolution": 2048}), size=(24, 32))
    lit = scene.description.model_copy(update={"lights": Lights(points=points, spots=spots)})
    [stage] = [
        one for one in PyrenderRenderer(replace(scene, description=lit)).plan.stages if one.name == "shadow maps"
    ]
    assert stage.method.startswith("48 maps of 2048 × 2048 texels")
    assert "; 2360 × 2360 texels and 64 samples change displayed values by " in stage.why  # a little below 1 GiB


@pytest.mark.usefixtures("software_opengl")
def test_maps_that_are_kept_leave_room_for_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """A light at as many places one after the other as there are layers, and at one more."""
    monkeypatch.setattr(compiled, "library", lambda: None)
    scene = over_ground(ball(), shadows=HARD.model_copy(update={"resolution": 72}), size=(24, 32))
    lit = scene.description.model_copy(update={"lights": Lights(points=(PointLight(position=PLACE.tolist()),))})
    scene = replace(scene, description=lit)
    kept, fresh = PyrenderRenderer(scene), PyrenderRenderer(scene)
    assert not kept.rasterises
    from scene_attack.rendering.opengl.shadow_maps import FEWEST_LAYERS  # it needs OpenGL, which is set up by now

    illuminations = kept.initial()["illumination"].repeat(FEWEST_LAYERS + 1, 1)
    illuminations[:, 1:] += torch.linspace(0, 0.3, FEWEST_LAYERS + 1)[:, None]
    one_by_one = [kept.render({"illumination": row[None]})[0] for row in illuminations]
    assert torch.equal(one_by_one[-1], fresh.render({"illumination": illuminations[-1:]})[0])
    assert not torch.equal(one_by_one[-1], one_by_one[-2])
