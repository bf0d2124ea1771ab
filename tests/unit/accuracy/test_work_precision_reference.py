"""The reference of the work-precision report, beside an independent program; and sizes of maps."""

import numpy as np
import pytest
import torch
from torch import Tensor

from services.accuracy.placing import library
from services.accuracy.work_precision import scene_options
from services.accuracy.work_precision.shading import GROUPS, Subject, subject, truth
from services.attacks.problem import generator
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader
from tests.unit.accuracy import independent

pytestmark = pytest.mark.slow

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))
PIXELS = 64
DIRECTIONS = 4
"""Random directions, of coordinates ±1, along which derivatives are compared in each group."""


@pytest.fixture(scope="module")
def small() -> Subject:
    return subject(*SMALL)


# The reference


def differences(of: Subject) -> dict[str, float]:
    """The largest differences of the float64 shader from the independent program, at PIXELS pixels of the object.

    Of displayed values at the moved values, of derivatives by each group relative to ‖gradient‖·‖direction‖, and of
    normals (radians) and displayed values where the program takes its normals from rays.
    """
    some = of.only(torch.linspace(0, len(of.pixels) - 1, PIXELS).long())
    light = independent.Light(independent.texels(library().environment("studio").radiance, *of.map))
    view, base = of.scene.view, some.surface.base_color.numpy().astype(np.longdouble)
    coverage, weights = some.coverage.numpy(), some.weights.numpy()
    at = {group: value.numpy().astype(np.longdouble) for group, value in some.moved.items()}
    wanted = truth(some, GROUPS)

    def image(values: dict[str, independent.Number]) -> independent.Number:
        normals = independent.normals_of(values["normals"], view)
        return coverage * independent.displayed(light, view, normals, values["illumination"], values["material"], base)

    found = {"image": float(np.abs(image(at) - wanted.image.numpy()).max())}
    for group in GROUPS:
        random = generator(0, "work-precision", "independent", group)
        off = []
        for _ in range(DIRECTIONS):
            signs = (torch.rand(some.moved[group].shape, generator=random, dtype=torch.float64) - 0.5).sign()
            step = at | {group: at[group] + 1j * np.longdouble(independent.STEP) * signs.numpy()}
            derivative = (weights * image(step).imag).sum() / independent.STEP
            size = float(wanted.gradients[group].norm() * signs.norm())
            off.append(abs(float(derivative) - float((wanted.gradients[group] * signs).sum())) / size)
        found[f"derivative by {group}"] = max(off)
    own = {"normals": some.surface.angles, "illumination": some.intensity, "material": some.surface.material}
    start = {group: value.numpy().astype(np.longdouble) for group, value in own.items()}
    shaded = some.image(Shader(exact_recipe(of.sky), of.sky, some.surface, of.intensity), own).numpy()
    rays, whole = independent.normals_by_rays(of.scene, some.pixels.numpy())
    whole &= coverage[:, 0] == 1
    by_rays = independent.displayed(light, view, rays[whole], start["illumination"], start["material"], base[whole])
    normals = independent.normals_of(start["normals"], view)[whole]
    found["normals by rays"] = float(np.linalg.norm((rays[whole] - normals).astype(np.float64), axis=1).max())
    found["image, normals by rays"] = float(np.abs(by_rays - shaded[whole]).max())
    return found


@pytest.mark.parametrize("texels", [(8, 16), (16, 32)])
def test_the_reference_is_an_independent_programs(texels: tuple[int, int]) -> None:
    """Float64 has 1e-16: a sum of 512 texels rounds to 1e-14 at the very most. Normals are rasterised in float32."""
    found = differences(subject(*SMALL[:3], texels))
    assert len(found) == 6
    for what, largest in found.items():
        assert largest < (1e-5 if "rays" in what else 1e-14), what


@pytest.mark.parametrize("factor", [1 + 1e-9, -1])
def test_a_reference_that_is_wrong_is_seen(small: Subject, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sum off by 1e-9, and one whose image is right and whose gradient has the other sign."""
    honest = Shader.__call__

    def wrong(self: Shader, angles: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        whole = honest(self, angles, illumination, material)
        return whole * factor if factor > 0 else 2 * whole.detach() - whole

    monkeypatch.setattr(Shader, "__call__", wrong)
    found = differences(small)
    assert (found["image"] > 1e-11) == (factor > 0)
    assert max(value for what, value in found.items() if "derivative" in what) > 1e-11


def test_larger_maps_are_nearer_to_the_largest() -> None:
    """Matte surfaces average over half the sky, so that they see less of the map's grid than gloss does."""
    rows = list(scene_options.map_rows("primitive/sphere", (24, 24), 0.0))
    found = {material: [row.mean for row in rows if row.scene == material] for material in scene_options.MATERIALS}
    for errors in found.values():
        assert errors == sorted(errors, reverse=True)
        assert 0 < errors[-1] < errors[0] / 4
    assert found["glossy-paint"][2] > found["matte"][2]
