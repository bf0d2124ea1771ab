"""Images and gradients of the torch renderer with shadows."""

import pytest
import torch
from torch.nn.functional import normalize

from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.torch import shading
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.shading import Directions, Lobes, radiance, transport
from scene_attack.rendering.torch.surfaces import WHOLE
from scene_attack.scenes.description import Shadows
from tests.unit.rendering.shading import sky
from tests.unit.rendering.shadow_scenes import ball, over_ground
from tests.unit.rendering.torch.test_shading import inputs


def lit(viewer: str = "distant", material: str = "plastic", shadows: Shadows | None = Shadows(), size=(18, 24)):  # noqa: B008
    scene = over_ground(ball(), shadows=shadows, size=size, viewer=viewer)
    object.__setattr__(scene, "environment", sky(8, 16))
    things = tuple(thing.model_copy(update={"material": material}) for thing in scene.description.objects)
    object.__setattr__(scene, "description", scene.description.model_copy(update={"objects": things}))
    return scene, rasterise(scene)


def shares(pixels: int, directions: int) -> torch.Tensor:
    random = torch.Generator().manual_seed(5)
    return torch.randint(0, 256, (directions, pixels), generator=random, dtype=torch.uint8)


@pytest.mark.usefixtures("kernel")
@pytest.mark.parametrize("pixels", [7, 50])
def test_visibility_is_a_factor_of_each_pixel_s_light(pixels: int) -> None:
    """One pixel at a time under the light that it sees is all pixels with their visibility; so are their factors."""
    normals, light, kappa, gamma, base, tilt, towards, half = inputs(pixels)
    lobes, ways, seen = Lobes(base, tilt, kappa, gamma), Directions(towards, half), shares(pixels, 6)
    whole = radiance(normals, light, lobes, ways, seen)
    alone = [
        radiance(n[None], light * share.double() / 255, lobes, ways) for n, share in zip(normals, seen.T, strict=True)
    ]
    torch.testing.assert_close(whole, torch.cat(alone), rtol=1e-12, atol=0)
    factors = transport(normals, lobes, ways, seen)
    torch.testing.assert_close(torch.einsum("cdn,cd->nc", factors, light), whole, rtol=1e-12, atol=0)


@pytest.mark.usefixtures("kernel")
def test_gradcheck() -> None:
    normals, light, kappa, gamma, base, tilt, towards, half = inputs()
    seen = shares(7, 6)

    def f(n, light, kappa, gamma):
        return radiance(normalize(n, dim=-1), light, Lobes(base, tilt, kappa, gamma), Directions(towards, half), seen)

    leaves = [value.clone().requires_grad_() for value in (normals, light, kappa, gamma)]
    size = f(*leaves).detach().abs().max()
    assert torch.autograd.gradcheck(lambda *v: f(*v) / size, leaves)


@pytest.mark.usefixtures("kernel")
def test_gradcheck_of_a_near_viewer() -> None:
    normals, light, *_, towards, _ = inputs()
    random = torch.Generator().manual_seed(3)
    material = torch.randn(3, 3, 2, 6, generator=random, dtype=torch.float64) * 0.5
    viewers = normalize(torch.randn(7, 3, generator=random, dtype=torch.float64) + torch.tensor([0, 0, 3.0]), dim=-1)
    seen = shares(7, 6)

    def f(n, light, material):
        return shading.perspective_radiance(normalize(n, dim=-1), viewers, light, material, towards, seen)

    leaves = [value.clone().requires_grad_() for value in (normals, light, material)]
    size = f(*leaves).detach().abs().max()
    assert torch.autograd.gradcheck(lambda *v: f(*v) / size, leaves)
    alone = [
        shading.perspective_radiance(
            normals[p : p + 1], viewers[p : p + 1], light * seen[:, p] / 255, material, towards
        )
        for p in range(7)
    ]
    torch.testing.assert_close(f(*leaves).detach(), torch.cat(alone), rtol=1e-12, atol=0)


@pytest.mark.parametrize("viewer", ["distant", "perspective"])
def test_finite_differences_of_the_exact_image(viewer: str) -> None:
    """Central differences along random directions in float64, of every group."""
    scene, gbuffer = lit(viewer, size=(9, 12))
    exact = TorchRenderer(scene, gbuffer, tolerance="exact")
    start = exact.initial()
    random = torch.Generator().manual_seed(1)
    weights = torch.randn(9, 12, 3, generator=random, dtype=torch.float64)
    for group, step in (("normals", 1e-6), ("illumination", 1e-5), ("illumination_rgb", 1e-5), ("material", 1e-5)):
        value = start[group] + (1.0 if group == "illumination" else 0.0)  # no texel at its bound
        others = {"illumination": start["illumination"] + 1.0} if group == "illumination_rgb" else {}
        others = {name: one[None] for name, one in others.items()}
        way = torch.randn(value.shape, generator=random, dtype=torch.float64)
        leaf = value[None].clone().requires_grad_()
        (exact.render({group: leaf} | others)[0] * weights).sum().backward()
        sides = torch.stack([value + step * way, value - step * way])
        held = {name: one.expand(2, *one.shape[1:]) for name, one in others.items()}
        up, down = (exact.render({group: sides} | held) * weights).sum(dim=(1, 2, 3))
        assert leaf.grad is not None
        assert float((up - down) / (2 * step)) == pytest.approx(float((leaf.grad[0] * way).sum()), rel=2e-5)


@pytest.mark.parametrize("groups", [("normals",), ("illumination",), ("normals", "illumination", "material")])
@pytest.mark.parametrize("viewer", ["distant", "perspective"])
def test_images_within_the_tolerance_and_gradients_near_the_exact_ones(groups: tuple[str, ...], viewer: str) -> None:
    scene, gbuffer = lit(viewer)
    renderer = TorchRenderer(scene, gbuffer, groups, 1e-3)
    values = {group: renderer.initial()[group][None] for group in groups}
    weights = torch.randn(18, 24, 3, generator=torch.Generator().manual_seed(2))
    images, gradients = [], []
    for one in (renderer, renderer.exact()):
        leaves = {
            group: value.to(one.initial()[group].dtype).detach().requires_grad_() for group, value in values.items()
        }
        images.append(one.render(leaves)[0].detach().double())
        (one.render(leaves)[0] * weights).sum().backward()
        gradients.append([leaf.grad.double() for leaf in leaves.values() if leaf.grad is not None])
    assert float((images[0] - images[1]).abs().max()) < renderer.plan.error <= 1e-3
    for own, truth in zip(*gradients, strict=True):
        assert float((own - truth).norm() / truth.norm()) < 2e-2
    parts = {stage.part for stage in renderer.plan.stages}
    ground = "object 0" if viewer == "perspective" else "object 0 in shadow"
    assert ground in parts
    [item] = [item for item in renderer.plan.items if item.what == "pixels that see all of the light"]
    assert 0 <= item.kept < item.of


def test_a_shadow_darkens_and_nothing_else_changes() -> None:
    """The image is that without shadows where all light is seen, and darker where it is not."""
    scene, gbuffer = lit(material="matte")
    plain, _ = lit(material="matte", shadows=None)
    shadowed = TorchRenderer(scene, gbuffer, tolerance="exact").render({})[0]
    without = TorchRenderer(plain, gbuffer, tolerance="exact").render({})[0]
    assert bool((shadowed <= without + 1e-12).all())
    assert float((without - shadowed).max()) > 0.05
    covered = gbuffer.coverage > 0
    assert torch.equal(shadowed[~covered], without[~covered])


def test_a_lone_ball_has_the_very_image_that_it_has_without_shadows() -> None:
    from scene_attack.scenes.description import Scene
    from tests.unit.rendering import shapes

    description = shapes.scene((40, 40), elevation=0.3)
    images = []
    for shadows in (None, Shadows()):
        scene = shapes.placed(Scene(**dict(description) | {"shadows": shadows}), shapes.mesh(shapes.sphere(0.5)))
        renderer = TorchRenderer(scene, rasterise(scene), ("normals",), 1e-3)
        assert not any("shadow" in stage.part for stage in renderer.plan.stages)
        images.append(renderer.render({}))
    assert torch.equal(*images)
    assert WHOLE == 255


def test_a_matte_scene_in_partial_shadow_looks_the_same_from_near_and_from_afar() -> None:
    """For a near viewer every pixel is summed with its own visibility, without regions in light and in shadow.

    A quarter of a step of 8 bits is allowed: `matte` is Lambertian but for an exponent of e⁻³⁰. Four samples of each
    texel make half of the visibilities partial.
    """
    images = []
    for viewer in ("distant", "perspective"):
        scene, gbuffer = lit(viewer, material="matte", size=(24, 32))
        images.append(TorchRenderer(scene, gbuffer, tolerance="exact").render({})[0])
    assert float((images[0] - images[1]).abs().max()) < 1e-3
