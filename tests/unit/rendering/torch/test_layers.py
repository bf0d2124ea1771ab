"""Gloss of dielectrics keeps the light's colour; what metals and bodies reflect has the mesh's."""

import pytest
import torch
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.torch.dsbrdf import colored_lobes, layers, presets
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.image_file import to_linear
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene

Albedo = tuple[float, float, float]


def linear(material: str, albedo: Albedo) -> Tensor:
    """Linear values [P, 3] of the wholly covered pixels of a sphere in a dim sky, none of them clipped."""
    scene = sphere_scene((24, 24), sky(8, 16), (material,))
    gbuffer = sphere_gbuffer(scene, albedo=albedo)
    renderer = TorchRenderer(scene, gbuffer, tolerance="exact")
    dim = 0.2 * renderer.initial()["illumination"][None]
    image = renderer.render({"illumination": dim})[0]
    assert image[gbuffer.coverage == 1].max() < 1
    return torch.from_numpy(to_linear(image.numpy()))[gbuffer.coverage == 1]


@pytest.mark.parametrize(
    ("material", "shines"),
    [("matte", 0), ("plastic", 1), ("glossy-paint", 1), ("brushed-metal", 0), ("rubber", 1), ("metal", 0)],
)
def test_a_black_dielectric_shines(material: str, shines: int) -> None:
    """Of a black mesh the gloss is left; a black metal and a black Lambertian body reflect nothing."""
    assert (linear(material, (0, 0, 0)).max() > 0.004) == bool(shines)


@pytest.mark.parametrize("material", presets())
def test_the_image_is_affine_in_the_mesh_s_colour(material: str) -> None:
    """I = base_color · body + gloss: of white and black follows every other colour, channel by channel."""
    white, black = linear(material, (1, 1, 1)), linear(material, (0, 0, 0))
    color = (0.7, 0.2, 0.05)
    wanted = black + torch.tensor(color, dtype=torch.float64) * (white - black)
    torch.testing.assert_close(linear(material, color), wanted, rtol=1e-6, atol=1e-9)  # base colours are float32


def test_gloss_has_the_colour_of_the_light() -> None:
    """In white light the gloss of a red sphere is white: its channels do not differ."""
    environment = sky(8, 16)[..., :1].repeat(3, axis=2)
    scene = sphere_scene((24, 24), environment, ("glossy-paint",))
    shown = TorchRenderer(scene, sphere_gbuffer(scene, albedo=(1e-6, 0, 0)), tolerance="exact").render({})[0]
    full = shown[sphere_gbuffer(scene).coverage == 1]
    assert full.amax() > 0.3
    torch.testing.assert_close(full, full[:, :1].expand(-1, 3), rtol=0, atol=1e-5)


def test_a_plan_has_both_layers_and_their_errors_add_up() -> None:
    scene = sphere_scene((96, 96), 0.3 + 0.2 * sky(16, 32), ("plastic",))
    plan = TorchRenderer(scene, sphere_gbuffer(scene), ("normals",), 1e-3).plan
    whats = {item.what for item in plan.items}
    assert {"directions of the body", "directions of the gloss"} <= whats
    entries = [*plan.items, *plan.stages]
    assert {entry.part for entry in entries if " of the gloss" in getattr(entry, "what", "")} == {"object 0"}
    assert plan.error == pytest.approx(sum(entry.error for entry in entries), rel=1e-12)
    assert 0 < plan.error <= 1e-3
    [pixels] = [item for item in plan.items if item.what == "pixels"]
    assert pixels.kept == int((sphere_gbuffer(scene).coverage > 0).sum())  # each once


def test_objects_keep_their_own_layers() -> None:
    found = layers(("matte", "plastic", "brushed-metal"))
    assert [[(layer.owner, layer.lobes, layer.colored) for layer in parts] for parts in found] == [
        [(0, (0, 1, 2), True)],
        [(1, (0,), True), (1, (1, 2), False)],
        [(2, (0, 1, 2), True)],
    ]
    with pytest.raises(InvalidRequest) as refused:
        layers(("matte", "velvet"))
    assert refused.value.field == "scene.objects.1.material"


def test_only_dielectrics_have_colourless_lobes() -> None:
    assert {name: colored_lobes(name) for name in presets()} == {
        "matte": (True, True, True),
        "plastic": (True, False, False),
        "glossy-paint": (True, False, False),
        "brushed-metal": (True, True, True),
        "rubber": (True, False, False),
        "metal": (True, True, True),
    }


def test_layers_of_a_far_attack_are_summed_in_every_group() -> None:
    """Float32 with a plan against the exact twin, all groups moved at once: the layers' bits are put together alike."""
    scene = sphere_scene((48, 48), sky(16, 32), ("plastic", "matte", "glossy-paint"))
    renderer = TorchRenderer(scene, sphere_gbuffer(scene), tolerance=1e-3)
    random = torch.Generator().manual_seed(2)
    start = renderer.initial()
    moved = {
        group: (start[group] + size * torch.randn(start[group].shape, generator=random))[None]
        for group, size in (("normals", 0.05), ("illumination", 0.1), ("material", 1.0))
    }
    moved["illumination"].clamp_(min=0)
    exact = renderer.exact().render({group: value.double() for group, value in moved.items()})
    assert (renderer.render(moved).double() - exact).abs().max() <= renderer.plan.error <= 1e-3
