"""What the work-precision report claims, on its quick extent; each claim fails where its method is broken."""

import dataclasses
from math import inf, sqrt
from pathlib import Path

import pytest
import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision import attack_runs, shading_methods
from services.accuracy.work_precision.attack_runs import Attacked, success
from services.accuracy.work_precision.collect import QUICK, Found, attacks, objectives, shading, slopes
from services.accuracy.work_precision.report import report, write
from services.accuracy.work_precision.shading_methods import GROUPS, ShadingRow, kernel, truth, ways
from services.accuracy.work_precision.shading_subject import Subject, subject
from services.accuracy.work_precision.single_sample import Sampled
from services.accuracy.work_precision.slopes import Objective, SlopeRow, along_directions, differences
from services.rendering.compositing import over_ground
from services.rendering.factory import build
from services.rendering.kernels import compiled
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.pyrender_renderer.renderer import EXPOSURE
from services.rendering.torch_renderer import lookup_table, shader
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader

SMALL = ("furniture/soccer-ball", "brushed-metal", (64, 64), (8, 16))


@pytest.fixture(scope="module")
def rows() -> list[ShadingRow]:
    return list(shading(QUICK))


@pytest.fixture(scope="module")
def slope_rows() -> list[SlopeRow]:
    return [row for objective in objectives(QUICK) for row in slopes(objective, QUICK)]


@pytest.fixture(scope="module")
def small() -> Subject:
    return subject(*SMALL)


def one(way: str, small: Subject, **wanted: object) -> ShadingRow:
    """The row of one way of shading."""
    [chosen] = [w for w in ways(False) if w.method == way and all(getattr(w, k) == v for k, v in wanted.items())]
    return shading_methods.row(chosen, small, truth(small, chosen.groups), 0.0)


# Shading


def test_the_subject_is_the_renderers_scene() -> None:
    """Shaded by itself it gives the picture that the exact renderer does: the report times what a job runs."""
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
    shown = small.picture(own, values) + (1 - small.coverage) * ground
    covered = rasterise(scene).coverage.flatten() > 0
    ordered = [picture.sort(dim=0).values for picture in (whole[covered], shown)]  # each has an order of its own
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
        for sharp in (0, 8):
            own = [r for r in rows if (r.method, r.dtype, r.map, r.sharp) == ("table", "float32", texels, sharp)]
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


def test_no_way_is_dropped(rows: list[ShadingRow]) -> None:
    """A way that cannot be gone is a row too."""
    assert len(rows) == 2 * len(ways(True))
    impossible = [row for row in rows if row.map == (4, 8) and row.method == "table" and row.sharp >= 32]
    assert impossible
    assert all(row.both is None and "32 directions" in row.note for row in impossible)


def test_a_kernel_is_chosen_and_the_former_comes_back() -> None:
    before = compiled.backend()
    with kernel("torch"):
        assert compiled.backend() == "torch"
    assert compiled.backend() == before != "torch"


def test_a_wrong_table_is_seen(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    good = one("table", small, rows=96, sharp=8, dtype="float32")
    assert good.note == ""
    monkeypatch.setattr(shader, "look_up", lambda values, angles: lookup_table.look_up(values, angles + 0.02))
    assert one("table", small, rows=96, sharp=8, dtype="float32").note.startswith("misses")


def test_a_wrong_gradient_is_seen(small: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture whose value is right and whose slope is not."""
    honest = Shader.__call__

    def half(self: Shader, angles: Tensor, illumination: Tensor, material: Tensor) -> Tensor:
        whole = honest(self, angles, illumination, material)
        return 0.5 * whole + 0.5 * whole.detach()

    wanted = truth(small, GROUPS)
    monkeypatch.setattr(Shader, "__call__", half)
    [way] = [w for w in ways(True) if w.method == "sum" and w.dtype == "float64"]
    row = shading_methods.row(way, small, wanted, 0.0)
    assert row.largest == 0
    assert all(error == pytest.approx(0.5) for error in row.gradient.values())


# Slopes


def cubic(resolution: torch.dtype = torch.float64) -> Objective:
    """Σ x³ at three places: forward differences are off by 3x δ, central ones by δ²."""
    at = torch.tensor([0.5, -1.0, 2.0], dtype=torch.float64)
    return Objective(
        renderer="none",
        group="x",
        of="Σ x³",
        pictures=("float64",),
        at=at,
        coordinates=torch.arange(3),
        values=lambda points: (points.double() ** 3).sum(1, keepdim=True),
        slopes=3 * at**2,
        how="by hand",
        resolution=resolution,
    )


def error(of: list[SlopeRow], **wanted: object) -> float:
    [row] = [row for row in of if all(getattr(row, key) == value for key, value in wanted.items())]
    return row.error


def test_forward_differences_are_of_first_order_and_central_of_second() -> None:
    found = list(differences(cubic()))
    length = float(cubic().slopes.norm())
    for delta in (1e-1, 1e-2, 1e-3):
        off = (3 * cubic().at * delta + delta**2).norm()
        assert error(found, estimator="forward", delta=delta) == pytest.approx(float(off) / length, rel=1e-4)
        assert error(found, estimator="central", delta=delta) == pytest.approx(sqrt(3) * delta**2 / length, rel=1e-3)
    assert {row.evaluations for row in found} == {4, 6}


def test_steps_that_a_number_cannot_take_divide_by_what_it_took() -> None:
    """float32 at 2 has steps of 2.4e-7: a quotient by δ = 1e-6 itself would be off by tenths."""
    found = list(differences(cubic(torch.float32), (1e-6, 1e-9)))
    assert error(found, estimator="central", delta=1e-6) < 1e-5
    assert error(found, estimator="central", delta=1e-9) == 1.0  # no step at all: slope 0


def test_random_directions_are_as_good_as_they_can_be() -> None:
    """√((n + 1) / c); the mean over 4,096 / c independent estimates is within a fifth of it."""
    found = list(along_directions(cubic(), (1, 8, 64, 4096)))
    for row in found[:3]:
        assert row.directions is not None
        assert row.error == pytest.approx(sqrt(4 / row.directions), rel=0.2)


def test_torch_differences_have_their_order(slope_rows: list[SlopeRow]) -> None:
    """With steps that are too small for a pixel to pass an edge of light, and large enough for float64."""
    own = [r for r in slope_rows if (r.group, r.picture, r.directions) == ("normals", "float64", None)]
    ratio = {
        estimator: error(own, estimator=estimator, delta=1e-4) / error(own, estimator=estimator, delta=1e-5)
        for estimator in ("central", "forward")
    }
    assert ratio["central"] == pytest.approx(100, rel=0.3)
    assert ratio["forward"] == pytest.approx(10, rel=0.1)


def test_central_differences_of_float_pictures_are_best_in_the_middle(slope_rows: list[SlopeRow]) -> None:
    """Curvature above, rounding below."""
    for group in ("normals", "light strength", "color", "light position"):
        own = [r for r in slope_rows if (r.group, r.picture, r.estimator) == (group, "float32", "central")]
        own = [row for row in own if row.samples in (None, 4)]
        errors = [row.error for row in own]
        best = errors.index(min(errors))
        assert 0 < best < len(errors) - 1
        assert errors[0] > 3 * errors[best]
        assert errors[-1] > 3 * errors[best]


@pytest.mark.parametrize("group", ["normals", "material", "light strength", "color", "light position"])
def test_eight_bits_are_useless_where_floats_are_good(slope_rows: list[SlopeRow], group: str) -> None:
    """At the paper's δ = 1e-4: a picture's values move by less than a step of 1/255."""
    own = [r for r in slope_rows if (r.group, r.estimator, r.delta) == (group, "central", 1e-4) and r.of[0] == "⟨"]
    by_picture = {row.picture: row for row in own if row.samples in (None, 4)}
    assert by_picture["float32"].error < 0.05
    assert by_picture["8 bit"].error > 0.5
    assert by_picture["8 bit"].note


def test_poses_need_large_steps(slope_rows: list[SlopeRow]) -> None:
    """Silhouettes jump: at δ = 1e-4 the slopes are wrong even in float, at 1e-2 their error is a fraction."""
    for group in ("translation", "rotation"):
        own = [
            r for r in slope_rows if (r.group, r.samples, r.picture, r.estimator) == (group, 4, "float32", "central")
        ]
        assert error(own, delta=1e-2) < 0.4
        assert error(own, delta=1e-4) > 0.5


def test_pictures_of_any_number_of_samples_are_pyrenders() -> None:
    """With four they are the exact renderer's, to the bit; with one they differ at silhouettes, and there alone."""
    scene = placed("primitive/cube", size=(48, 48))
    exact = build(scene, "pyrender").exact()
    start = {group: value[None] for group, value in exact.initial().items()}
    ground = torch.tensor(scene.description.ground)
    pictures = [over_ground(Sampled(scene, samples).radiance(start), EXPOSURE, ground) for samples in (4, 1)]
    torch.testing.assert_close(pictures[0], exact.render(start), rtol=0, atol=1e-6)
    far = (pictures[1] - pictures[0]).abs().amax(-1) > 0.02
    assert 0 < far.double().mean() < 0.1


# Attacks


def attacked(outcome: str, queries: int) -> Attacked:
    return Attacked.model_validate(
        {
            "scene": "s",
            "label": "l",
            "renderer": "torch",
            "method": "fgsm",
            "groups": ("normals",),
            "tolerance": 1e-3,
            "seed": 0,
            "outcome": outcome,
            "queries": queries,
            "most": 9,
        }
    )


def test_attacks_that_held_count_as_held() -> None:
    """Fooled in the loop only is not a success, nor is a scene that was wrong to begin with an attack."""
    runs = [
        attacked("verified", 7),
        attacked("held", 20),
        attacked("fooled in the loop only", 20),
        attacked("verified", 3),
        attacked("wrong to begin with", 0),
    ]
    assert list(success(runs, "queries")) == [(3.0, 0.25), (7.0, 0.5)]


def test_a_scene_that_the_network_gets_wrong_is_a_row() -> None:
    [case, *_] = attack_runs.cases(1, 1, 1, {"steps": 1})
    found = attack_runs.attack(dataclasses.replace(case, label="grand piano"))
    assert found.outcome == "wrong to begin with"
    assert found.queries == 0


def test_the_report_says_everything(rows: list[ShadingRow], slope_rows: list[SlopeRow], tmp_path: Path) -> None:
    runs = list(attacks(dataclasses.replace(QUICK, steps=2, zoo={"steps": 1, "delta": 1e-2})))
    assert len(runs) == 10
    assert {row.outcome for row in runs} <= {"verified", "held", "fooled in the loop only"}
    write(report(Found(rows, [], slope_rows, runs), "a command"), tmp_path)
    page = (tmp_path / "work-precision.md").read_text("utf-8")
    assert page.count("| sum |") + page.count("| sum, in torch |") == 8
    assert page.count("\n| furniture/soccer-ball | ") == len(runs)
    for heading in ("Ways of shading", "Estimates of gradients", "Whole attacks", "What is left out", "again"):
        assert heading in page
    assert "a command" in page
    assert (tmp_path / "work-precision.png").stat().st_size > 50_000
    read = type(report(Found(), "")).model_validate_json((tmp_path / "work-precision.json").read_text("utf-8"))
    assert [row.note for row in read.shading] == [row.note for row in rows]
    assert inf not in [row.error for row in read.slopes]
