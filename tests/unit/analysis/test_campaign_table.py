"""The table of a campaign, against counts made by hand."""

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.axes import Axes

from scene_attack.analysis.campaign_figure import draw
from scene_attack.analysis.campaign_table import (
    Case,
    Curves,
    Rate,
    corners,
    mean,
    mean_curve,
    mean_curves,
    share_at,
    table,
    tex,
    time_left,
    to_csv,
    to_latex,
)


def case(attack: str = "a", target: str = "t", **changed: Any) -> Case:
    """A case that held."""
    values: dict[str, Any] = {
        "state": "succeeded",
        "right": True,
        "outcome": "held",
        "queries": 100,
        "seconds": 10.0,
        "truncated": 4,
        "perceptibility": 0.03,
        "loop_perceptibility": 0.02,
        "run_seconds": 12.0,
    }
    return Case(target=target, attack=attack, **(values | changed))


def fooled(queries: int, p: float = 0.01, **changed: Any) -> Case:
    values: dict[str, Any] = {"outcome": "fooled", "success": True, "loop_success": True, "queries": queries}
    return case(**(values | {"seconds": queries / 10, "perceptibility": p, "loop_perceptibility": p / 2} | changed))


CASES = [
    fooled(7, 0.01),
    fooled(3, 0.03),
    fooled(7, 0.02),
    case(truncated=9),
    case(loop_success=True, loop_perceptibility=0.008),  # fooled by the truncated image only
    case(right=False, outcome="became-right", truncated=1000),
    case(right=False, outcome="still-wrong", truncated=1000),
    case(right=False, outcome="changed", truncated=1000),
    Case(target="t", attack="a", state="failed", right=True),
    Case(target="t", attack="a", state="failed", right=False),
    Case(target="t", attack="a", state="cancelled", right=True),
]
PLANNED = [("t", "a")] * 12 + [("t", "b"), ("u", "a")]


def test_cases_that_held_within_their_epsilon_are_counted() -> None:
    cases = [case(epsilon_bound=True), case(epsilon_bound=True), case(), fooled(7, epsilon_bound=True)]
    found = table("c", [("t", "a")] * 4, cases).cell("t", "a")
    assert found is not None
    assert (found.outcomes, found.held_within_epsilon) == ({"fooled": 1, "held": 3}, 2)


def test_survival_is_the_mean_of_the_successes_that_were_asked_for_it() -> None:
    """The interval is that of 2.25 of 3, written out; equal shares have one, too."""
    cases = [fooled(3, survival=0.5), fooled(3, survival=0.75), fooled(3, survival=1.0), fooled(3), case(survival=0.0)]
    found = table("c", [("t", "a")] * 5, cases)
    survival = found.cells[0].survival
    assert survival is not None
    assert (survival.mean, survival.of) == (0.75, 3)
    z2 = 1.959964**2
    half = 1.959964 * (0.75 * 0.25 / 3 + z2 / 36) ** 0.5
    assert survival.low == pytest.approx((0.75 + z2 / 6 - half) / (1 + z2 / 3))
    assert survival.high == pytest.approx((0.75 + z2 / 6 + half) / (1 + z2 / 3))
    [certain] = table("c", [("t", "a")], [fooled(3, survival=1.0)]).cells
    assert certain.survival is not None
    assert certain.survival.low < 0.3
    [row] = csv.DictReader(io.StringIO(to_csv(found)))
    assert (row["survival_mean"], row["survival_of"]) == ("0.75", "3")
    assert table("c", [("t", "a")], [fooled(3)]).cells[0].survival is None


def test_only_scenes_that_were_right_count_and_no_failure_is_left_out() -> None:
    found = table("c", PLANNED, CASES).cell("t", "a")
    assert found is not None
    assert (found.jobs, found.ended, found.failed, found.cancelled) == (12, 11, 2, 1)
    # three successes; held, fooled in the loop and one of the failed ones stay in the denominator
    assert (found.success.count, found.success.of, found.success.rate) == (3, 6, 0.5)
    assert (found.loop_success.count, found.loop_success.of) == (4, 6)
    assert found.outcomes == {"became-right": 1, "changed": 1, "fooled": 3, "held": 2, "still-wrong": 1}
    assert found.perceptibility == pytest.approx(0.02)
    assert found.loop_perceptibility == pytest.approx((0.005 + 0.015 + 0.01 + 0.008) / 4)
    assert found.truncated == 5  # of the five that have a result: 4, 4, 4, 9 and 4


def test_the_step_curve_rises_at_each_success_and_ends_at_the_rate() -> None:
    found = table("c", PLANNED, CASES).cell("t", "a")
    assert found is not None
    assert found.by_queries == [(3.0, 1), (7.0, 3)]
    assert found.by_seconds == [(0.3, 1), (0.7, 3)]
    shares = [share_at(found.by_queries, found.success.of, at) for at in (0, 2.99, 3, 6.99, 7, 1e9)]
    assert shares == [0, 0, 1 / 6, 1 / 6, 3 / 6, 3 / 6]


def test_the_drawn_curve_is_a_share_of_all_cases_that_were_right(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Those that held or failed are in its denominator: three of six end at 50 %, from the first query to the last."""
    drawn: list[tuple[list[float], list[float], str]] = []

    def step(_axes: Axes, x: list[float], y: list[float], *, where: str, label: str) -> None:
        assert where == "post"
        drawn.append((list(x), list(y), label))

    monkeypatch.setattr(Axes, "step", step)
    monkeypatch.setattr(Axes, "legend", lambda _: None)
    draw(table("c", PLANNED, CASES), [], tmp_path / "curves.png")
    along_queries = drawn[0]
    end = 100 * 1.05  # the queries of the cases that held
    assert along_queries == ([0.0, 3.0, 7.0, end], pytest.approx([0, 100 / 6, 50, 50]), "a (n = 6)")


def test_a_campaign_that_attacks_nothing_has_empty_curves(tmp_path: Path) -> None:
    draw(table("c", [], []), [], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_rows_and_columns_are_in_the_order_of_the_plan() -> None:
    found = table("c", PLANNED, CASES)
    assert (found.targets, found.attacks) == (["t", "u"], ["a", "b"])
    assert found.cell("u", "b") is None
    empty = found.cell("u", "a")
    assert empty is not None
    assert empty.success == Rate(count=0, of=0, rate=None, low=None, high=None)


def test_means_and_corners_of_nothing() -> None:
    assert mean([]) is None
    assert mean([None, 2.0]) == 2.0
    assert corners([None]) == []
    assert share_at([], 5, 10.0) == 0.0


def test_a_mean_curve_keeps_the_last_value_of_a_case_that_has_ended() -> None:
    assert mean_curve([[1.0, 0.0], [1.0, 0.8, 0.6, 0.4], []]) == pytest.approx([1.0, 0.4, 0.3, 0.2])
    assert mean_curve([]) == []
    one, other = (Curves(loss=[a], advantage=[2 * a], distance=[0.0]) for a in (1.0, 3.0))
    [found] = mean_curves([("t", "a", one), ("t", "a", other)])
    assert (found.cases, found.loss, found.advantage) == (2, [2.0], [4.0])


def test_the_csv_has_a_line_for_each_cell() -> None:
    made = table('=1+1, "c"', PLANNED, CASES)
    lines = list(csv.DictReader(io.StringIO(to_csv(made))))
    assert [(line["target"], line["attack"]) for line in lines] == [("t", "a"), ("t", "b"), ("u", "a")]
    first = lines[0]
    assert first["campaign"] == '\'=1+1, "c"'  # no formula
    assert (first["jobs"], first["success_count"], first["success_of"], first["held"]) == ("12", "3", "6", "2")
    assert float(first["perceptibility"]) == pytest.approx(0.02)
    assert lines[1]["success_rate"] == ""


def test_every_row_of_the_latex_table_has_all_columns() -> None:
    found = to_latex(table("c", [*PLANNED, ("x_y", "50 % & more")], CASES))
    count = 1 + 2 * 3
    rows = [line for line in found.splitlines() if line.endswith(r"\\")]
    assert len(rows) == 2 + 4 * 3
    for row in rows[1:]:
        assert len(re.findall(r"(?<!\\)&", row)) == count - 1, row
    assert r"x\_y" in found
    assert r"50 \% \& more" in found
    assert "t & 50.0 & 20.0 & --" in found
    assert found.count("{") == found.count("}")


def test_special_characters_are_escaped() -> None:
    assert tex(r"a\b~c^d#e") == r"a\textbackslash{}b\textasciitilde{}c\textasciicircum{}d\#e"


def test_the_time_left_is_that_of_like_jobs() -> None:
    planned = [("t", "a")] * 3 + [("t", "b")] * 2 + [("u", "a"), ("u", "c")]
    done = [
        case("a", run_seconds=10.0),
        case("a", run_seconds=20.0),
        case("b", run_seconds=100.0),
        case("c", "v", run_seconds=1.0, reused=True),
    ]
    # left: t a 15, t b 100, u a as on t 15, u c as all: 130 / 3
    assert time_left(planned, done[:3]) == pytest.approx(15 + 100 + 15 + 130 / 3)
    assert time_left(planned, done[:3], workers=2) == pytest.approx((15 + 100 + 15 + 130 / 3) / 2)
    assert time_left(planned, []) is None
    assert time_left([], []) == 0.0
