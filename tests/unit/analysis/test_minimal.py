"""The minimal change against rays whose fooling scales are known in closed form."""

from collections.abc import Callable

import pytest
import torch

from scene_attack.analysis.minimal import minimal_change, scan_and_bisect
from scene_attack.analysis.records import MinimalChange, MinimalRequest
from scene_attack.analysis.subsets import scored
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.physical_change import PhysicalChange
from scene_attack.rendering.protocol import Parameters
from tests.unit.analysis.test_attribution import Built, Pixels


@pytest.mark.parametrize("threshold", [0.01, 0.3, 0.5, 0.77, 1.0])
def test_a_threshold_is_found_to_the_resolution(threshold: float) -> None:
    asked: list[float] = []

    def fooled(scale: float) -> bool:
        asked.append(scale)
        return scale >= threshold

    found, held = scan_and_bisect(fooled, 8, 10)
    assert len(asked) == 18
    assert found is not None
    assert held < threshold <= found
    assert found - held == pytest.approx(1 / (8 * 2**10), rel=1e-9)
    assert found in asked
    assert held == 0 or held in asked


def test_an_island_below_the_threshold_is_found_where_plain_bisection_would_miss_it() -> None:
    """Fooled on [0.2, 0.3] and from 0.9 on: bisection of [0, 1] alone ends at 0.9."""

    def fooled(scale: float) -> bool:
        return 0.2 <= scale <= 0.3 or scale >= 0.9

    found, held = scan_and_bisect(fooled, 16, 12)
    assert found is not None
    assert held < 0.2 <= found < 0.2 + 1e-4


def test_nothing_on_the_ray_fools() -> None:
    asked: list[float] = []
    assert scan_and_bisect(lambda scale: bool(asked.append(scale)), 4, 10) == (None, 1.0)
    assert asked == [0.25, 0.5, 0.75, 1.0]


def no_words(perturbation: Parameters) -> list[PhysicalChange]:
    return [
        PhysicalChange(group=g, subject="", measure="sum", value=float(v.sum()), unit="")
        for g, v in perturbation.items()
    ]


def ray(target: Built, perturbation: Parameters, tick: Callable[[int, int], None] = lambda *_: None) -> MinimalChange:
    verifier = Verifier(Pixels(), target)
    return minimal_change(
        verifier,
        ResolvedGoal((0,), None),
        perturbation,
        scored(verifier, {}),
        MinimalRequest(scans=10, bisections=6),
        physical=no_words,
        tick=tick,
    )


def test_the_boundary_of_the_8_bit_image() -> None:
    """Pixel 0 goes from 0 to 40 steps of 1/255, and the network, 6.5 at the start, loses 1 a step: fooled from 7 on.

    The saved pixel is 7 from a scale of 6.5/40 on, where the rounding to 8 bits changes.
    """
    target = Built([-1.0] + 8 * [0.0], {}, offset=6.5)
    ticks: list[tuple[int, int]] = []
    moved = {"a": torch.tensor([[40.0, 0, 0], [0, 0, 0]], dtype=torch.float64)}
    found = ray(target, moved, lambda done, of: ticks.append((done, of)))
    assert ticks == [(k, 16) for k in range(16)]
    assert found.images == 16
    assert found.smallest is not None
    assert found.holds_at < 6.5 / 40 < found.smallest.scale
    assert found.smallest.scale - found.holds_at == pytest.approx(0.1 / 2**6)
    assert found.fools_from == pytest.approx(0.2)
    assert [point.fooled for point in found.scan] == [False] + 9 * [True]
    # one pixel of nine, grey: p = sqrt(3 · (40 s / 255)² / 9) before rounding, and at 7/255 as saved
    scale = found.smallest.scale
    assert found.smallest.float_perceptibility == pytest.approx((3 * (40 * scale / 255) ** 2 / 9) ** 0.5, rel=1e-9)
    assert found.smallest.perceptibility == pytest.approx((3 * (7 / 255) ** 2 / 9) ** 0.5, rel=1e-9)
    assert found.change[0].value == pytest.approx(40 * scale)
    assert found.stored_change[0].value == 40


def test_a_ray_that_is_not_monotone_is_reported_as_such() -> None:
    """Log-odds 30 − 20 x + x² of the pixel's value x in 0…20 are below 0 from 2 to 18 only: the ray's end holds."""
    target = Built([-20.0] + 8 * [0.0], {(0, 0): 1.0}, offset=30.0)
    found = ray(target, {"a": torch.tensor([[20.0, 0, 0], [0, 0, 0]], dtype=torch.float64)})
    assert [point.fooled for point in found.scan] == 9 * [True] + [False]
    assert found.smallest is not None
    assert found.smallest.scale == pytest.approx(1.5 / 20, abs=0.1 / 2**6)  # x is saved as 2 from 1.5 on
    assert found.fools_from is None


def test_a_perturbation_that_never_fools_has_no_minimal_change() -> None:
    found = ray(Built(9 * [1.0], {}), {"a": torch.ones(2, 3, dtype=torch.float64)})
    assert found.smallest is None
    assert found.fools_from is None
    assert found.change == []
    assert len(found.stored_change) == 1
