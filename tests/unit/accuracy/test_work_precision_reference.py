"""The reference of the work-precision report, beside an independent program; and sizes of maps."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from scene_attack.attacks.problem import generator
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.shader import Shader
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack_accuracy.placing import library
from scene_attack_accuracy.work_precision import (
    GROUPS,
    MATERIALS,
    SOME_WAY,
    map_rows,
    moved,
    shaded,
    smooth_weights,
    subject,
)
from tests.unit.accuracy import independent

pytestmark = pytest.mark.slow

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))
PIXELS = 64
DIRECTIONS = 4
"""Random directions, of coordinates ±1, along which derivatives are compared in each group."""


def differences(scene: ResolvedScene) -> dict[str, float]:
    """The largest differences of the exact renderer from the independent program, at PIXELS pixels of the object.

    Of displayed values some way into an attack, of derivatives by each group relative to ‖gradient‖·‖direction‖, and of
    normals (radians) and displayed values where the program takes its normals from rays.
    """
    gbuffer = rasterise(scene)
    covered = gbuffer.coverage.flatten().nonzero()[:, 0]
    pixels = covered[torch.linspace(0, len(covered) - 1, PIXELS).long()]
    renderer = TorchRenderer(scene, gbuffer, GROUPS, "exact")
    weights = torch.zeros(gbuffer.coverage.numel(), 3, dtype=torch.float64)
    weights[pixels] = smooth_weights(renderer.size).reshape(-1, 3)[pixels]
    moved_values = moved(renderer, SOME_WAY)
    image, gradients = shaded(renderer, moved_values, weights.reshape(*renderer.size, 3))

    def seen(values: Parameters) -> dict[str, Tensor]:
        """Normals [PIXELS, 2], intensities [D] and the material [3, 3, 2, 6] of the object."""
        normals = values["normals"].reshape(-1, 2)[pixels]
        material = values["material"].reshape(3, 3, 2, 6)
        return {"normals": normals, "illumination": values["illumination"].flatten(), "material": material}

    rows, cols, _ = scene.environment.shape
    light = independent.Light(independent.texels(library().environment("studio").radiance, rows, cols))
    base = gbuffer.base_color.reshape(-1, 3)[pixels].numpy().astype(np.longdouble)
    coverage = gbuffer.coverage.flatten()[pixels, None].double().numpy()
    ground = (1 - coverage) * np.array(scene.description.ground)

    def independent_image(values: dict[str, independent.Number]) -> independent.Number:
        normals, rest = (
            independent.normals_of(values["normals"], scene.view),
            (values["illumination"], values["material"]),
        )
        return coverage * independent.displayed(light, scene.view, normals, *rest, base) + ground

    at = {group: value.numpy().astype(np.longdouble) for group, value in seen(moved_values).items()}
    shown = image.reshape(-1, 3)[pixels].numpy()
    found = {"image": float(np.abs(independent_image(at) - shown).max())}
    for group, gradient in seen(gradients).items():
        random = generator(0, "work-precision", "independent", group)
        off = []
        for _ in range(DIRECTIONS):
            signs = (torch.rand(gradient.shape, generator=random, dtype=torch.float64) - 0.5).sign()
            step = at | {group: at[group] + 1j * np.longdouble(independent.STEP) * signs.numpy()}
            derivative = (weights[pixels].numpy() * independent_image(step).imag).sum() / independent.STEP
            size = float(gradient.norm() * signs.norm())
            off.append(abs(float(derivative) - float((gradient * signs).sum())) / size)
        found[f"derivative by {group}"] = max(off)
    start = {group: value.numpy().astype(np.longdouble) for group, value in seen(renderer.initial()).items()}
    own = renderer.render({})[0].reshape(-1, 3)[pixels].numpy()
    rays, whole = independent.normals_by_rays(scene, pixels.numpy())
    whole &= coverage[:, 0] == 1
    rest = (start["illumination"], start["material"], base[whole])
    by_rays = independent.displayed(light, scene.view, rays[whole], *rest)
    normals = independent.normals_of(start["normals"], scene.view)[whole]
    found["normals by rays"] = float(np.linalg.norm((rays[whole] - normals).astype(np.float64), axis=1).max())
    found["image, normals by rays"] = float(np.abs(by_rays - own[whole]).max())
    return found


@pytest.mark.parametrize("texels", [(8, 16), (16, 32)])
def test_the_reference_is_an_independent_programs(texels: tuple[int, int]) -> None:
    """Float64 has 1e-16: a sum of 512 texels rounds to 1e-14 at the very most. Normals are rasterised in float32."""
    found = differences(subject(*SMALL[:3], texels))
    assert len(found) == 6
    for what, largest in found.items():
        assert largest < (1e-5 if "rays" in what else 1e-14), what


@pytest.mark.parametrize("factor", [1 + 1e-9, -1])
def test_a_reference_that_is_wrong_is_seen(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sum off by 1e-9, and one whose image is right and whose gradient has the other sign."""
    honest = Shader.__call__

    def wrong(self: Shader, *given: Any) -> Tensor:
        whole = honest(self, *given)
        return whole * factor if factor > 0 else 2 * whole.detach() - whole

    monkeypatch.setattr(Shader, "__call__", wrong)
    found = differences(subject(*SMALL))
    assert (found["image"] > 1e-11) == (factor > 0)
    assert max(value for what, value in found.items() if "derivative" in what) > 1e-11


def test_larger_maps_are_nearer_to_the_largest() -> None:
    """Matte surfaces average over half the sky, so that they see less of the map's grid than gloss does."""
    rows = list(map_rows("primitive/sphere", (24, 24), 0.0))
    found = {material: [row.mean for row in rows if row.scene == material] for material in MATERIALS}
    for errors in found.values():
        assert errors == sorted(errors, reverse=True)
        assert 0 < errors[-1] < errors[0] / 4
    assert found["glossy-paint"][2] > found["matte"][2]
