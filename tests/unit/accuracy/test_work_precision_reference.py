"""The reference of the work-precision report, its orders of convergence and its signs."""

from math import pi

import pytest
import torch
from torch import Tensor

from services.accuracy.work_precision import convergence, independent_check, map_resolution, network_signs
from services.accuracy.work_precision.convergence import slope, smooth_orders
from services.accuracy.work_precision.extent import QUICK
from services.accuracy.work_precision.shading_subject import GROUPS, Subject, subject
from services.accuracy.work_precision.signs import wrong_signs
from services.rendering.torch_renderer.shader import Shader

pytestmark = pytest.mark.slow

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))


@pytest.fixture(scope="module")
def small() -> Subject:
    return subject(*SMALL)


# The reference


@pytest.mark.parametrize("texels", [(8, 16), (16, 32)])
def test_the_reference_is_an_independent_programs(texels: tuple[int, int]) -> None:
    """Float64 has 1e-16: a sum of 512 texels rounds to 1e-14 at the very most. Normals are rasterised in float32."""
    found = {row.what: row for row in independent_check.comparisons(subject(*SMALL[:3], texels))}
    assert len(found) == 6
    for what, row in found.items():
        assert row.largest < (1e-5 if "rays" in what else 1e-14), what


@pytest.mark.parametrize("factor", [1 + 1e-9, -1])
def test_a_reference_that_is_wrong_is_seen(small: Subject, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sum off by 1e-9, and one whose image is right and whose gradient has the other sign."""
    honest = Shader.__call__

    def wrong(self: Shader, angles: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        whole = honest(self, angles, illumination, material)
        return whole * factor if factor > 0 else 2 * whole.detach() - whole

    monkeypatch.setattr(Shader, "__call__", wrong)
    found = {row.what: row.largest for row in independent_check.comparisons(small)}
    assert (found["image at the moved values"] > 1e-11) == (factor > 0)
    assert max(value for what, value in found.items() if "derivative" in what) > 1e-11


def test_larger_maps_are_nearer_to_the_largest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matte surfaces average over half the sky, so that they see less of the map's grid than gloss does."""
    monkeypatch.setattr(map_resolution, "MATERIALS", ("matte", "glossy-paint"))
    found = {(row.material, row.map): row.rms for row in map_resolution.rows("primitive/sphere", (24, 24))}
    for material in map_resolution.MATERIALS:
        errors = [found[material, texels] for texels in map_resolution.MAPS]
        assert errors == sorted(errors, reverse=True)
        assert 0 < errors[-1] < errors[0] / 4
    assert found["glossy-paint", (16, 32)] > found["matte", (16, 32)]


# Orders


def test_the_order_of_a_power_is_its_exponent() -> None:
    rows = [48, 64, 96, 128]
    order, error = slope(rows, [7 * r**-2.5 for r in rows])
    assert order == pytest.approx(2.5)
    assert error == pytest.approx(0, abs=1e-12)
    bent = slope(rows, [r**-2.5 * factor for r, factor in zip(rows, (1, 1.1, 1, 1.1), strict=True)])
    assert bent[1] > 0.05


def test_lookups_of_smooth_functions_have_the_stated_orders(small: Subject) -> None:
    """Within a tenth of 3 for values and of 2 for derivatives."""
    for row in smooth_orders(small.surface.angles):
        assert row.order == pytest.approx(row.stated, rel=0.1), row.error
        assert row.standard_error < 0.15


def test_a_lookup_of_lower_order_is_seen(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """The value of the nearest node is off in proportion to the spacing."""

    def nearest(table: Tensor, angles: Tensor) -> Tensor:
        rows = int((len(table) // 2) ** 0.5)
        column, row = ((angles.detach() / pi + torch.tensor([1.0, 0.0])) * rows).long().unbind(-1)
        return table[row * 2 * rows + column] + 0 * angles.sum()

    monkeypatch.setattr(convergence, "look_up", nearest)
    found = {row.error: row.order for row in smooth_orders(small.surface.angles)}
    assert found["rms"] == pytest.approx(1, rel=0.1)


# Signs


def test_wrong_signs_are_counted_and_weighed() -> None:
    wanted = torch.tensor([4.0, -3.0, 2.0, -1.0, 0.0, 0.0])
    found = torch.tensor([1.0, 3.0, 0.0, -9.0, 5.0, 0.0])
    wrong = wrong_signs(found, wanted)
    assert wrong.share == 3 / 5  # the second, the third (estimated as 0) and the fifth; the sixth is 0 in both
    assert wrong.weight == pytest.approx(0.5)


def test_signs_through_the_network_are_lost_by_rounding_not_by_the_plan() -> None:
    """Exactly and without rounding only the network's float32 is left. Within 1e-3, a quarter of a step of 8 bits, the
    plan loses less than the 8 bits do."""
    found = list(network_signs.rows(*QUICK.gradients))
    weight = {(row.group, row.tolerance, row.image): row.wrong_weight for row in found}
    assert len(weight) == len(found) == 3 * 4 * 2
    for group in GROUPS:
        assert weight[group, "exact", "unrounded"] < 1e-3
        assert weight[group, 1e-3, "unrounded"] < weight[group, "exact", "8 bit"] < 0.5
