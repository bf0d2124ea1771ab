"""What the work-precision report claims, on a small extent that is measured once; a claim of shading fails where its
method is broken."""

import dataclasses
from itertools import pairwise, product
from pathlib import Path

import pytest
import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision import scene_options, shading
from services.accuracy.work_precision.report import PARTS, QUICK, Report, measure, read
from services.accuracy.work_precision.shading import (
    GROUPS,
    ShadingMethod,
    ShadingRow,
    Subject,
    kernel,
    subject,
    truth,
)
from services.rendering.factory import build
from services.rendering.kernels import compiled
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer import shader, table
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Recipe, Shader

pytestmark = pytest.mark.slow

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))


TINY = dataclasses.replace(QUICK, enough=0.0, scene=(24, 32), steps=2, zoo={"steps": 1, "delta": 1e-2})
NAMES = ["matte objects", "rubber and metal", "floor", "shadows"]


@dataclasses.dataclass(frozen=True)
class Measured:
    """A report of every part, its folder, and the parts in the order in which they were begun."""

    report: Report
    folder: Path
    parts: list[str]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    folder = tmp_path_factory.mktemp("report")
    parts: list[str] = []
    return Measured(measure(TINY, folder, "a command", on_part=parts.append), folder, parts)


@pytest.fixture(scope="module")
def rows(measured: Measured) -> list[ShadingRow]:
    return measured.report.shading


@pytest.fixture(scope="module")
def small() -> Subject:
    return subject(*SMALL)


def test_the_report_says_everything(measured: Measured) -> None:
    made, folder = measured.report, measured.folder
    assert measured.parts == list(PARTS) == list(made.measured)
    assert read(folder) == made
    page = (folder / "work-precision.md").read_text("utf-8")
    headings = [line for line in page.splitlines() if line.startswith("## ")]
    assert headings == [
        *("## Which tolerance", "## Plans", "## Types of number", "## Resolution of the environment map"),
        *("## Resolution of shadows", "## Surfaces, floor and shadows"),
        *("## Work to a verified adversary", "## What is left out", "## How to make this page again"),
    ]
    for above, below in pairwise(headings):
        section = page[page.index(above) : page.index(below)]
        assert ("\n| :---" in section) == (above not in ("## Which tolerance", "## What is left out")), above
    assert f"`a command`, {made.measured['maps'].when}; load: " in page


# Shading


def test_the_subject_is_the_renderers_scene(small: Subject) -> None:
    """Shaded by itself it gives the image that the exact renderer does: the report times what a job runs."""
    scene = placed(
        SMALL[0],
        size=SMALL[2],
        thing={"material": SMALL[1]},
        lights={"environment": {"map": "studio", "size": SMALL[3]}},
    )
    renderer = build(scene, "torch", tolerance="exact")
    whole = renderer.render({g: v[None] for g, v in renderer.initial().items()})[0].reshape(-1, 3)
    own = Shader(exact_recipe(small.sky), small.sky, small.surface, small.intensity)
    values = {"normals": small.surface.angles, "illumination": small.intensity, "material": small.surface.material}
    ground = torch.tensor(scene.description.ground, dtype=torch.float64)
    shown = small.image(own, values) + (1 - small.coverage) * ground
    covered = rasterise(scene).coverage.flatten() > 0
    ordered = [image.sort(dim=0).values for image in (whole[covered], shown)]  # each has an order of its own
    torch.testing.assert_close(ordered[1], ordered[0], rtol=0, atol=1e-12)


def test_sums_in_float32_are_off_by_rounding_alone(rows: list[ShadingRow]) -> None:
    """A hundred roundings of float32 at most, in the compiled loops and in torch."""
    sums = [row for row in rows if row.tolerance is None and row.dtype == "float32"]
    assert {row.kernel for row in sums} == {"native", "torch"}
    for row in sums:
        assert row.largest is not None
        assert 0 < row.largest < 1e-5
        assert max(row.gradient.values()) < 1e-5


def test_bfloat16_misses_and_says_so(rows: list[ShadingRow]) -> None:
    narrow = [row.note for row in rows if row.dtype == "bfloat16"]
    assert len(narrow) == 2
    assert all(note.startswith("misses") for note in narrow)


def test_plans_hold_what_they_promise(rows: list[ShadingRow]) -> None:
    plans = [row for row in rows if row.tolerance is not None]
    assert len(plans) == 32
    for row in plans:
        limit = 1e-12 if row.tolerance == "exact" else row.estimate
        assert row.largest is not None
        assert limit is not None
        assert row.largest <= limit
        assert row.note in ("", "checked, and summed pixel by pixel after all")


def test_a_kernel_is_chosen_and_the_former_comes_back() -> None:
    before = compiled.backend()
    with kernel("torch"):
        assert compiled.backend() == "torch"
    assert compiled.backend() == before != "torch"


def test_a_wrong_table_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a plan that was made while tables were right, and without the check that would sum the pixels after all."""
    large = subject(*SMALL[:2], (128, 128), SMALL[3])
    recipe, _ = ShadingMethod(GROUPS, tolerance=1e-2).recipe(large)
    assert recipe.rows is not None

    class Unchecked(ShadingMethod):
        def recipe(self, of: Subject) -> tuple[Recipe, float | None]:
            return dataclasses.replace(recipe, guard=None), None

    wanted, unchecked = truth(large, GROUPS), Unchecked(GROUPS, tolerance=1e-2)
    assert shading.row(unchecked, large, wanted, 0.0).note == ""
    monkeypatch.setattr(shader, "look_up", lambda values, angles: table.look_up(values, angles + 0.05))
    assert shading.row(unchecked, large, wanted, 0.0).note.startswith("misses")


def test_a_wrong_gradient_is_seen(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """An image whose value is right and whose gradient is not."""
    honest = Shader.__call__

    def half(self: Shader, angles: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        whole = honest(self, angles, illumination, material)
        return 0.5 * whole + 0.5 * whole.detach()

    wanted = truth(small, GROUPS)
    monkeypatch.setattr(Shader, "__call__", half)
    found = shading.row(ShadingMethod(GROUPS, torch.float64), small, wanted, 0.0)
    assert found.largest == 0
    assert all(error == pytest.approx(0.5) for error in found.gradient.values())


def test_what_a_method_raises_becomes_a_note(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object) -> Tensor:
        raise ZeroDivisionError("the first line\nand another")

    wanted = truth(small, GROUPS)
    monkeypatch.setattr(shading, "repeated", failing)
    found = shading.row(ShadingMethod(GROUPS, torch.float64), small, wanted, 0.0)
    assert found.note == "ZeroDivisionError: the first line"
    assert found.largest is None


# A scene's options


def test_each_scene_has_one_more_option() -> None:
    found = dict(scene_options.scenes(TINY.scene))
    assert list(found) == NAMES
    assert [of.floor is not None for of in found.values()] == [False, False, True, True]
    assert [of.shadows is not None for of in found.values()] == [False, False, False, True]
    for name, of in found.items():
        assert {one.material for one in of.objects} <= ({"matte"} if name == NAMES[0] else {"rubber", "metal"})
        assert all((one.metallic is None) == (name == NAMES[0]) for one in of.objects)


def test_every_scene_is_measured_with_both_renderers_within_every_tolerance(measured: Measured) -> None:
    rows = measured.report.scenes
    wanted = list(product(NAMES, ("pyrender", "torch"), scene_options.TOLERANCES))
    assert [(row.scene, row.renderer) for row in rows] == [pair[:2] for pair in wanted]
    for row, (*_, tolerance) in zip(rows, wanted, strict=True):
        if tolerance == "exact":
            assert row.largest == 0
            continue
        assert row.mean <= tolerance
        if row.renderer == "torch":
            assert row.estimate is not None
            assert 0 < row.largest <= row.estimate <= tolerance
