"""The torch renderer's floor: shaded, lit and bent like an object, with a material that is no value of a group."""

from dataclasses import replace
from math import pi, sqrt
from typing import Any

import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.physical_change import physical_changes
from scene_attack.rendering.torch import planner
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings

SIDE = 2.5
BALL = {"mesh": "primitive/sphere", "material": "matte", "scale": 0.5, "color": (0.8, 0.3, 0.1)}
UNDER = {"size": SIDE, "height": -0.4, "color": (0.4, 0.5, 0.6), "material": "plastic"}
AS_OBJECT = {
    "mesh": "primitive/plane",
    "rotation": (-pi / 2, 0.0, 0.0),
    "scale": SIDE / (sqrt(2) * FIT_RADIUS),
    "translation": (0.0, -0.4, 0.0),
    "color": (0.4, 0.5, 0.6),
    "material": "plastic",
}
GROUPS = ("normals", "illumination", "material")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))


def renderer(library: Library, *objects: dict[str, Any], groups: tuple[str, ...] = GROUPS, **more: Any) -> Any:
    camera = {"size": (24, 32), "azimuth": 0.4, "elevation": 0.5, "distance": 2.6}
    light = {"environment": {"map": "uniform", "size": (8, 16), "rotation": 0.3}}
    given = {"camera": camera, "lights": light, "objects": objects} | more
    scene = resolve(Scene.model_validate(given), library)
    # Outlines as without a floor, where a pixel shows the mean of its surfaces.
    return TorchRenderer(scene, replace(rasterise(scene), fragments=None), groups)


@pytest.fixture(scope="module")
def floored(library: Library) -> TorchRenderer:
    found: TorchRenderer = renderer(library, BALL, floor=UNDER)
    return found


@pytest.fixture(scope="module")
def plane(library: Library) -> TorchRenderer:
    """The same square as an object."""
    found: TorchRenderer = renderer(library, BALL, AS_OBJECT)
    return found


def test_it_looks_like_the_same_square_as_an_object(floored: TorchRenderer, plane: TorchRenderer) -> None:
    one, two = floored.exact().render({})[0], plane.exact().render({})[0]
    # Its corners are rounded to float32 in another space: a sample at an edge may fall to the other side.
    assert float(((one - two).abs().amax(-1) > 1e-6).double().mean()) < 0.01
    assert float((one - 128 / 255).abs().amax(-1).gt(0.01).double().mean()) > 0.4


def test_its_light_and_normals_are_attacked_and_its_material_is_not(
    floored: TorchRenderer, plane: TorchRenderer
) -> None:
    assert floored.initial()["material"].shape == (1, 3, 3, 2, 6)
    gradients = []
    for made in (floored, plane):
        start = {group: value[None].requires_grad_() for group, value in made.exact().initial().items()}
        image = made.exact().render(start)
        weights = torch.linspace(-1, 1, image.numel(), dtype=image.dtype).reshape(image.shape)
        (image * weights).sum().backward()
        gradients.append({group: value.grad[0] for group, value in start.items() if value.grad is not None})
    one, two = gradients
    assert torch.equal(one["material"][0], two["material"][0])
    apart = (one["normals"] - two["normals"]).abs().amax(-1) > 1e-6
    assert float(apart.double().mean()) < 0.01
    assert float((one["normals"] != 0).any(-1)[-1].double().mean()) > 0.5  # the last row is floor
    torch.testing.assert_close(one["illumination"], two["illumination"], rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("groups", [("material",), ("illumination",), ("normals",), GROUPS])
def test_every_set_of_groups_is_within_its_plan_s_error(library: Library, groups: tuple[str, ...]) -> None:
    made = renderer(library, BALL, floor=UNDER, groups=groups)
    moved = {group: 1.01 * value[None] for group, value in made.initial().items() if group in groups}
    exact = {group: value.double() for group, value in moved.items()}
    off = (made.render(moved).double() - made.exact().render(exact)).abs().max()
    assert float(off) <= made.plan.error
    assert {stage.part for stage in made.plan.stages} == {"object 0", "floor"}
    measured = {(one.part, one.group) for one in made.plan.gradients if one.part.startswith("floor")}
    assert {group for _, group in measured} == set(groups) - {"material"}


@pytest.mark.slow
def test_a_floor_under_attacked_light_is_a_product_stored_once(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The image and its gradient are those of the sum, which the plan falls back to if the factors take too much
    memory; both are near the exact sum, the gradient by central differences in float64."""
    matte = {"floor": UNDER | {"material": "matte"}, "shadows": {}, "groups": ("illumination",)}
    stored = renderer(library, BALL, **matte)
    monkeypatch.setattr(planner, "TRANSPORT_BYTES", 0)
    summed = renderer(library, BALL, **matte)
    for made, method in ((stored, "product of the light with factors computed once"), (summed, "sum over directions")):
        stages = [stage for stage in made.plan.stages if stage.part.startswith("floor")]
        assert [stage.part for stage in stages] == ["floor in shadow"]
        assert stages[0].method.startswith(method)
        assert ("the factors take" in stages[0].why) == (made is stored)

    random = torch.Generator().manual_seed(0)
    light = stored.initial()["illumination"][None]
    light = light * (0.5 + torch.rand(light.shape, generator=random))
    weights = torch.randn(*stored.size, 3, generator=random, dtype=torch.float64)
    exact = stored.exact().render({"illumination": light.double()})[0]
    found = []
    for made in (stored, summed):
        leaf = light.clone().requires_grad_()
        image = made.render({"illumination": leaf})[0].double()
        assert float((image - exact).detach().abs().max()) <= made.plan.error
        found.append(torch.autograd.grad((image * weights).sum(), leaf)[0].double())
    assert float((found[0] - found[1]).norm() / found[1].norm()) < 1e-5  # float32, in another order

    step = light.double() * (torch.rand(light.shape, generator=random, dtype=torch.float64) - 0.5)
    sides = [stored.exact().render({"illumination": light + sign * 1e-4 * step})[0] for sign in (1, -1)]
    difference = float(((sides[0] - sides[1]) * weights).sum()) / 2e-4
    assert float((found[0] * step).sum()) == pytest.approx(difference, rel=5e-3)  # the plan states 4e-4, in length


def test_physical_changes_and_plans_leave_its_material_out(floored: TorchRenderer, library: Library) -> None:
    change = {"material": torch.full((1, 3, 3, 2, 6), 0.5)}
    scene = resolve(Scene.model_validate({"objects": [BALL], "floor": UNDER}), library)
    assert {one.subject for one in physical_changes(scene, floored, change)} == {"object 0 κ", "object 0 γ"}
    with pytest.raises(ValueError, match="material"):
        floored.render({"material": torch.zeros(1, 2, 3, 3, 2, 6)})


def test_the_plan_says_that_metallic_and_roughness_are_pyrender_s(library: Library) -> None:
    made = renderer(library, BALL | {"metallic": 1.0}, BALL, floor=UNDER | {"roughness": 0.3})
    [item] = [item for item in made.plan.items if item.what == "metallic and roughness"]
    assert (item.kept, item.of) == (0, 2)
    assert not [item for item in made.plan.items if item.what == "materials of the file"]


def test_an_unknown_material_is_refused_by_its_field(library: Library) -> None:
    with pytest.raises(InvalidRequest, match="glossy-paint") as refused:
        renderer(library, BALL, floor=UNDER | {"material": "glosy-paint"})
    assert refused.value.field == "scene.floor.material"


def test_objects_that_the_floor_hides_are_out_of_view(library: Library) -> None:
    buried = BALL | {"scale": 0.1, "translation": (0.0, -0.6, 0.0)}
    with pytest.raises(InvalidRequest, match="no object covers") as refused:
        renderer(library, buried, floor=UNDER)
    assert refused.value.field == "scene.objects"


def test_an_outline_is_the_mean_of_the_colours_that_meet_there(library: Library) -> None:
    """A cube on a floor: each pixel is between the colours of its surfaces, drawn by themselves."""
    cube = BALL | {"mesh": "primitive/cube", "rotation": (0.0, 0.6, 0.0)}
    camera = {"size": (24, 32), "azimuth": 0.4, "elevation": 0.5, "distance": 2.6}
    lights = {"ambient": 0.1, "environment": {"map": "lights", "size": (8, 16)}}
    given = {"camera": camera, "lights": lights, "objects": [cube], "floor": UNDER | {"material": "matte"}}
    scene = resolve(Scene.model_validate(given), library)
    gbuffer = rasterise(scene)
    assert gbuffer.fragments is not None
    renderer = TorchRenderer(scene, gbuffer, ("normals",))
    image = renderer.exact().render({})[0].reshape(-1, 3)
    shown = gbuffer.fragments
    expected = torch.zeros_like(image)
    for k in range(int(shown.rank.max()) + 1):
        own = shown.rank == k
        flat = {"normals": torch.zeros(24 * 32, 3), "base_color": torch.zeros(24 * 32, 3)}
        index = torch.full((24 * 32,), -1)
        flat["normals"][shown.pixels[own]], flat["base_color"][shown.pixels[own]] = (
            shown.normals[own],
            shown.base_color[own],
        )
        index[shown.pixels[own]] = shown.object_index[own]
        covered = (index >= 0).float().reshape(24, 32)
        alone = replace(
            gbuffer,
            normals=flat["normals"].reshape(24, 32, 3),
            base_color=flat["base_color"].reshape(24, 32, 3),
            object_index=index.reshape(24, 32),
            coverage=covered,
            fragments=None,
        )
        colors = TorchRenderer(scene, alone, tolerance="exact").render({})[0].reshape(-1, 3)
        expected[shown.pixels[own]] += shown.share[own, None] * colors[shown.pixels[own]]
    ground = torch.tensor(scene.description.ground, dtype=torch.float64)
    expected += (1 - gbuffer.coverage.reshape(-1, 1)) * ground
    assert float((image - expected).abs().max()) < 1e-6
    assert int(shown.rank.max()) >= 2
    # A change of a pixel's angles turns all of its surfaces: gradients by differences, at pixels of two or more.
    pixel = int(shown.pixels[shown.rank == 1][3])
    start = renderer.exact().initial()["normals"]
    way = torch.zeros_like(start)
    way[pixel // 32, pixel % 32, 1] = 1.0
    leaf = start[None].clone().requires_grad_()
    renderer.exact().render({"normals": leaf}).sum().backward()
    up, down = (renderer.exact().render({"normals": (start + s * 1e-6 * way)[None]}).sum() for s in (1, -1))
    assert leaf.grad is not None
    assert float((up - down) / 2e-6) == pytest.approx(float((leaf.grad[0] * way).sum()), rel=1e-5)
    assert float(leaf.grad.abs().sum()) > 0
