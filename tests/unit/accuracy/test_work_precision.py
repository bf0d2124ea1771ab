"""What the work-precision report claims, on a small extent that is measured once."""

import dataclasses
from itertools import pairwise, product
from pathlib import Path

import pytest

from scene_attack.rendering.factory import build
from scene_attack.rendering.torch import shader, table
from scene_attack_accuracy.work_precision import (
    GROUPS,
    OPTION_TOLERANCES,
    QUICK,
    SOME_WAY,
    Report,
    markdown,
    measure,
    moved,
    scenes,
    shaded,
    smooth_weights,
    subject,
    write,
)

pytestmark = pytest.mark.slow

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))


TINY = dataclasses.replace(QUICK, enough=0.0, scene=(24, 32))
PARTS = ["shading", "maps", "shadows", "scenes"]
NAMES = ["matte objects", "rubber and metal", "floor", "shadows"]


@pytest.fixture(scope="module")
def report() -> Report:
    begun: list[str] = []
    measured = measure(TINY, "a command", begun.append)
    assert begun == PARTS
    return measured


def test_the_report_says_everything(report: Report, tmp_path: Path) -> None:
    write(report, tmp_path / "new")
    assert Report.model_validate_json((tmp_path / "new" / "work-precision.json").read_text("utf-8")) == report
    page = (tmp_path / "new" / "work-precision.md").read_text("utf-8")
    assert page == markdown(report)
    headings = [line for line in page.splitlines() if line.startswith("## ")]
    assert headings == [
        *("## Which tolerance", "## Plans", "## Resolution of the environment map"),
        *("## Resolution of shadows", "## Surfaces, floor and shadows"),
        *("## What is left out", "## How to make this page again"),
    ]
    for above, below in pairwise(headings):
        section = page[page.index(above) : page.index(below)]
        assert ("\n| :---" in section) == (above not in ("## Which tolerance", "## What is left out")), above
    assert f"`a command`, {report.measured.when}; load: " in page


# Shading


def test_plans_hold_what_they_promise(report: Report) -> None:
    rows = report.shading
    assert len(rows) == 32
    for row in rows:
        assert row.largest <= (1e-12 if row.tolerance == "exact" else row.estimate)
        assert row.gradient.keys() == set(row.groups)
        assert max(row.gradient.values()) < (1e-9 if row.tolerance == "exact" else 0.1)


def test_a_wrong_table_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a plan that was made while tables were right, and without the check that would sum the pixels after all."""
    scene = subject(*SMALL[:2], (128, 128), SMALL[3])
    renderer = build(scene, "torch", groups=GROUPS, tolerance=1e-2)
    assert any("table" in stage.method for stage in renderer.plan.stages)
    weights = smooth_weights((128, 128))
    reference = shaded(renderer.exact(), values := moved(renderer, SOME_WAY), weights)
    monkeypatch.setattr(shader, "displayed_error", lambda *_: 0.0)
    assert float((shaded(renderer, values, weights).image - reference.image).abs().max()) <= renderer.plan.error
    monkeypatch.setattr(shader, "look_up", lambda values, angles: table.look_up(values, angles + 0.05))
    assert float((shaded(renderer, values, weights).image - reference.image).abs().max()) > renderer.plan.error


# A scene's options


def test_each_scene_has_one_more_option() -> None:
    found = dict(scenes(TINY.scene))
    assert list(found) == NAMES
    assert [of.floor is not None for of in found.values()] == [False, False, True, True]
    assert [of.shadows is not None for of in found.values()] == [False, False, False, True]
    for name, of in found.items():
        assert {one.material for one in of.objects} <= ({"matte"} if name == NAMES[0] else {"rubber", "metal"})
        assert all((one.metallic is None) == (name == NAMES[0]) for one in of.objects)


def test_every_scene_is_measured_with_both_renderers_within_every_tolerance(report: Report) -> None:
    rows = report.scenes
    wanted = list(product(NAMES, ("pyrender", "torch"), OPTION_TOLERANCES))
    assert [(row.scene, row.renderer) for row in rows] == [pair[:2] for pair in wanted]
    for row, (*_, tolerance) in zip(rows, wanted, strict=True):
        if tolerance == "exact":
            assert row.largest == 0
            continue
        assert row.mean <= tolerance
        if row.renderer == "torch":
            assert row.estimate is not None
            assert 0 < row.largest <= row.estimate <= tolerance
