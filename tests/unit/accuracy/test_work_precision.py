"""What the work-precision report claims of shading, on its quick extent; a claim fails where its method is broken."""

import dataclasses
from math import inf
from pathlib import Path

import pytest
import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision import shading_rows
from services.accuracy.work_precision.attack_runs import SCENES
from services.accuracy.work_precision.collect import Found, collect, shading
from services.accuracy.work_precision.extent import QUICK
from services.accuracy.work_precision.map_resolution import MapRow
from services.accuracy.work_precision.progress import Progress
from services.accuracy.work_precision.report import report, write
from services.accuracy.work_precision.shading_methods import kernel, methods
from services.accuracy.work_precision.shading_rows import TOO_FINE, ShadingRow, truth
from services.accuracy.work_precision.shading_subject import GROUPS, Subject, subject
from services.accuracy.work_precision.timing import repeated
from services.rendering.factory import build
from services.rendering.kernels import compiled
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer import lookup_table, shader
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader

pytestmark = pytest.mark.slow

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))


@pytest.fixture(scope="module")
def rows() -> list[ShadingRow]:
    found = Found()
    shading(QUICK, Progress(), found)
    return found.shading


@pytest.fixture(scope="module")
def small() -> Subject:
    return subject(*SMALL)


def one(name: str, small: Subject, **wanted: object) -> ShadingRow:
    """The row of one method of shading."""
    [chosen] = [m for m in methods(False) if m.name == name and all(getattr(m, k) == v for k, v in wanted.items())]
    return shading_rows.row(chosen, small, truth(small, chosen.groups), 0.0)


# Shading


def test_the_subject_is_the_renderers_scene() -> None:
    """Shaded by itself it gives the image that the exact renderer does: the report times what a job runs."""
    small = subject(*SMALL)
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
    sums = [row for row in rows if row.method == "sum" and row.dtype == "float32"]
    assert {row.kernel for row in sums} == {"native", "torch"}
    for row in sums:
        assert row.largest is not None
        assert 0 < row.largest < 1e-5
        assert max(row.gradient.values()) < 1e-5


def test_bfloat16_misses_and_says_so(rows: list[ShadingRow]) -> None:
    assert all(row.note.startswith("misses") for row in rows if row.dtype == "bfloat16")


def test_tables_get_better_with_rows(rows: list[ShadingRow]) -> None:
    """Four times the rows, at least four times less: the order of an interpolation of a function with kinks is one."""
    for texels in {row.map for row in rows}:
        for texels_beside in (0, 8):
            kind = ("table", "float32", texels, texels_beside)
            own = [r for r in rows if (r.method, r.dtype, r.map, r.per_pixel_texels) == kind]
            errors = [row.rms for row in own if row.rms is not None]
            assert errors == sorted(errors, reverse=True)
            assert errors[0] > 4 * errors[2]


def test_plans_hold_what_they_promise(rows: list[ShadingRow]) -> None:
    plans = [row for row in rows if row.method == "plan"]
    assert len(plans) == 32
    for row in plans:
        limit = 1e-12 if row.tolerance == "exact" else row.estimate
        assert row.largest is not None
        assert limit is not None
        assert row.largest <= limit
        assert row.note in ("", TOO_FINE, "checked, and summed pixel by pixel after all")


def test_methods_that_make_no_sense_are_counted() -> None:
    """Half of 32 texels or more beside a table: in one row, and not among those measured."""
    found = Found()
    tiny = dataclasses.replace(QUICK, subjects=((SMALL[0], SMALL[1], (16, 16), ((4, 8),)),), enough=0.0)
    shading(tiny, Progress(), found)
    [left_out] = found.cannot_run
    assert len(found.shading) + left_out.methods == len(methods(True))
    assert (
        left_out.methods == 16
    )  # of four sizes each: tables beside 32 and 128 texels, float64 and fixed ones beside 32
    assert all(row.per_pixel_texels <= 16 for row in found.shading if "table" in row.method)


def test_a_kernel_is_chosen_and_the_former_comes_back() -> None:
    before = compiled.backend()
    with kernel("torch"):
        assert compiled.backend() == "torch"
    assert compiled.backend() == before != "torch"


def test_a_wrong_table_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """On an image that is large enough for the shader to use the table."""
    large = subject(*SMALL[:2], (128, 128), SMALL[3])
    good = one("table", large, rows=64, per_pixel_texels=8, dtype="float32")
    assert good.note == ""
    monkeypatch.setattr(shader, "look_up", lambda values, angles: lookup_table.look_up(values, angles + 0.02))
    assert one("table", large, rows=64, per_pixel_texels=8, dtype="float32").note.startswith("misses")


def test_tables_that_are_not_used_say_so(small: Subject) -> None:
    """A plan's table with more nodes than pixels is summed: to rounding, and with the evaluations of a sum."""
    [table] = [
        m for m in methods(False) if (m.name, m.rows, m.per_pixel_texels, m.dtype) == ("table", 256, 8, "float32")
    ]
    recipe = dataclasses.replace(table.recipe(small)[0], guard=1.0)
    as_planned = dataclasses.replace(table, recipe=lambda _: (recipe, None))
    row, plain = shading_rows.row(as_planned, small, truth(small, GROUPS), 0.0), one("sum", small, dtype="float64")
    assert row.note == TOO_FINE
    assert row.largest is not None
    assert row.largest < 1e-5
    assert row.evaluations == plain.evaluations


def test_a_wrong_gradient_is_seen(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """An image whose value is right and whose gradient is not."""
    honest = Shader.__call__

    def half(self: Shader, angles: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        whole = honest(self, angles, illumination, material)
        return 0.5 * whole + 0.5 * whole.detach()

    wanted = truth(small, GROUPS)
    monkeypatch.setattr(Shader, "__call__", half)
    [method] = [m for m in methods(True) if m.name == "sum" and m.dtype == "float64"]
    row = shading_rows.row(method, small, wanted, 0.0)
    assert row.largest == 0
    assert all(error == pytest.approx(0.5) for error in row.gradient.values())


# The report


def test_times_have_a_spread() -> None:
    times = repeated(lambda: sum(range(1000)), 0.0)
    assert times.repeats == 5
    assert 0 < times.shortest <= times.lower <= times.median <= times.upper


def test_the_report_says_everything(tmp_path: Path) -> None:
    """Stopped and continued it says the same: nothing that was measured is measured again."""
    tiny = dataclasses.replace(
        QUICK,
        subjects=((*SMALL[:2], (32, 32), ((4, 8),)),),
        scene=(24, 32),
        enough=0.0,
        steps=2,
        zoo={"steps": 1, "delta": 1e-2},
    )
    steps: list[str] = []
    first = collect(tiny, Progress(tmp_path / "partial", "tiny", steps.append))
    assert len(steps) > 15
    again = collect(tiny, Progress(tmp_path / "partial", "tiny", lambda step: pytest.fail(step)))
    assert again == first
    made = report(again, "a command", "none")
    write(made, tmp_path)
    page = (tmp_path / "work-precision.md").read_text("utf-8")
    assert page.index("## Conclusions") < page.index("![")
    assert page.count("| sum |") + page.count("| sum, in torch |") == 4
    assert sum(page.count(f"\n| {SCENES[0][0]} | {method} | ") for method in ("fgsm", "zoo")) == len(made.attacks) == 9
    for heading in (
        *("Work to a verified adversary", "The reference", "Resolution of the environment map"),
        *("Resolution of shadows", "Surfaces, floor and shadows"),
        *(
            "Orders of convergence",
            "Signs that FGSM takes",
            "Methods of shading",
            "Estimates of gradients",
            "Whole attacks",
            "What is left out",
            "again",
        ),
    ):
        assert heading in page
    assert page.count("methods cannot run here") == 1
    assert "a command" in page
    assert (tmp_path / "work-precision.png").stat().st_size > 50_000
    read = type(made).model_validate_json((tmp_path / "work-precision.json").read_text("utf-8"))
    assert read == made
    assert inf not in [row.error for row in read.gradients]


def test_progress_is_kept_and_a_cut_line_is_measured_again(tmp_path: Path) -> None:
    path = tmp_path / "partial"
    row = MapRow(mesh="m", material="matte", map=(4, 8), reference=(64, 128), pixels=1, largest=0.5, rms=0.5)
    calls: list[str] = []
    for _ in range(2):
        progress = Progress(path, "this", calls.append)
        assert progress.rows("a", MapRow, lambda: [row]) == [row]
    assert calls == ["a"]
    with path.open("a") as file:
        file.write('{"key": "b", "ro')
    assert Progress(path, "this").rows("b", type(row), list) == []
    assert Progress(path, "this", calls.append).rows("a", type(row), list) == [row]
    assert Progress(path, "that", calls.append).rows("a", type(row), list) == []
    assert calls == ["a", "a"]
