"""What the work-precision report claims of shading, on its quick extent; a claim fails where its method is broken."""

import dataclasses
from math import inf
from pathlib import Path

import pytest
import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision import independent_check, network_signs, shading_rows
from services.accuracy.work_precision.collect import QUICK, Found, collect, shading
from services.accuracy.work_precision.convergence import slope, smooth_orders
from services.accuracy.work_precision.progress import Progress
from services.accuracy.work_precision.report import report, write
from services.accuracy.work_precision.shading_methods import kernel, methods
from services.accuracy.work_precision.shading_rows import ShadingRow, truth
from services.accuracy.work_precision.shading_subject import GROUPS, Subject, subject
from services.accuracy.work_precision.signs import wrong_signs
from services.accuracy.work_precision.timing import repeated
from services.rendering.factory import build
from services.rendering.kernels import compiled
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer import lookup_table, shader
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader

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
        assert row.note in ("", "checked, and summed pixel by pixel after all")


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


def test_a_wrong_table_is_seen(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    good = one("table", small, rows=96, per_pixel_texels=8, dtype="float32")
    assert good.note == ""
    monkeypatch.setattr(shader, "look_up", lambda values, angles: lookup_table.look_up(values, angles + 0.02))
    assert one("table", small, rows=96, per_pixel_texels=8, dtype="float32").note.startswith("misses")


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
    """Linear interpolation is of order 2."""

    def linear(f: Tensor) -> Tensor:
        return torch.stack((0 * f, 1 - f, f, 0 * f), dim=-1)

    monkeypatch.setenv("SCENE_ATTACK_KERNEL", "torch")
    monkeypatch.setattr(lookup_table, "_catmull_rom", linear)
    with kernel("torch"):
        found = {row.error: row.order for row in smooth_orders(small.surface.angles)}
    assert found["rms"] == pytest.approx(2, rel=0.1)


# Signs


def test_wrong_signs_are_counted_and_weighed() -> None:
    wanted = torch.tensor([4.0, -3.0, 2.0, -1.0, 0.0, 0.0])
    found = torch.tensor([1.0, 3.0, 0.0, -9.0, 5.0, 0.0])
    wrong = wrong_signs(found, wanted)
    assert wrong.share == 3 / 5  # the second, the third (estimated as 0) and the fifth; the sixth is 0 in both
    assert wrong.weight == pytest.approx(0.5)


def test_signs_through_the_network_get_better_with_the_tolerance() -> None:
    """Exactly and without rounding only the network's float32 is left; the loop's signs lose next to nothing."""
    found = list(network_signs.rows(*QUICK.gradients))
    assert {row.group for row in found} == set(GROUPS)
    for group in GROUPS:
        own = [row for row in found if row.group == group]
        assert own[0].image == "unrounded"
        assert own[0].wrong_weight < 1e-3
        assert own[0].wrong_weight <= min(row.wrong_weight for row in own)


# The report


def test_times_have_a_spread() -> None:
    times = repeated(lambda: sum(range(1000)), 0.0)
    assert times.repeats == 5
    assert 0 < times.shortest <= times.lower <= times.median <= times.upper


def test_the_report_says_everything(tmp_path: Path) -> None:
    """Stopped and continued it says the same: nothing that was measured is measured again."""
    tiny = dataclasses.replace(
        QUICK, subjects=((*SMALL[:2], (32, 32), ((4, 8),)),), enough=0.0, steps=2, zoo={"steps": 1, "delta": 1e-2}
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
    assert page.count("\n| furniture/soccer-ball | fgsm | ") + page.count("\n| furniture/soccer-ball | zoo | ") == 9
    for heading in (
        *("Work to a verified adversary", "The reference", "Orders of convergence", "Signs that FGSM takes"),
        *("Methods of shading", "Estimates of gradients", "Whole attacks", "What is left out", "again"),
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
    [row] = [row for row in smooth_orders(torch.tensor([[0.1, 1.0], [0.5, 1.5]])) if row.error == "rms"]
    calls: list[str] = []
    for _ in range(2):
        progress = Progress(path, "this", calls.append)
        assert progress.rows("a", type(row), lambda: [row]) == [row]
    assert calls == ["a"]
    with path.open("a") as file:
        file.write('{"key": "b", "ro')
    assert Progress(path, "this").rows("b", type(row), list) == []
    assert Progress(path, "this", calls.append).rows("a", type(row), list) == [row]
    assert Progress(path, "that", calls.append).rows("a", type(row), list) == []
    assert calls == ["a", "a"]
