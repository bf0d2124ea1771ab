"""What the work-precision report says of a scene's options, on a small image."""

from itertools import product

import pytest

from services.accuracy.work_precision import scene_options
from services.accuracy.work_precision.scene_options import TOLERANCES, SceneRow, scenes

pytestmark = pytest.mark.slow

NAMES = ["matte objects", "rubber and metal", "floor", "shadows"]


@pytest.fixture(scope="module")
def rows() -> list[SceneRow]:
    return list(scene_options.option_rows((24, 32), 0.0))


def test_each_scene_has_one_more_option() -> None:
    found = dict(scenes((24, 32)))
    assert list(found) == NAMES
    assert [of.floor is not None for of in found.values()] == [False, False, True, True]
    assert [of.shadows is not None for of in found.values()] == [False, False, False, True]
    for name, of in found.items():
        assert {one.material for one in of.objects} <= ({"matte"} if name == NAMES[0] else {"rubber", "metal"})
        assert all((one.metallic is None) == (name == NAMES[0]) for one in of.objects)


def test_every_scene_is_measured_with_both_renderers_within_every_tolerance(rows: list[SceneRow]) -> None:
    wanted = list(product(NAMES, ("pyrender", "torch"), TOLERANCES))
    assert [(row.scene, row.renderer, row.tolerance) for row in rows] == wanted
    for row in rows:
        if row.tolerance == "exact":
            assert row.largest == 0
            continue
        assert row.mean <= row.tolerance
        if row.renderer == "torch":
            assert 0 < row.largest <= row.estimate <= row.tolerance
    assert {row.pixels for row in rows if row.scene == "shadows"} == {24 * 32}  # the floor fills the image
