"""Tables of any two fields of a campaign's cases, computed by hand."""

import csv
import io
from typing import Any

import pytest

from scene_attack.analysis.campaign_table import CASE_FIELDS, Case, CaseRow, best, cases_to_csv, grid, worst


def row(number: int, scene: str = "chair", azimuth: str = "0°", **changed: Any) -> CaseRow:
    values: dict[str, Any] = {
        "target": "net",
        "attack": "image",
        "state": "succeeded",
        "right": True,
        "outcome": "fooled",
        "success": True,
        "perceptibility": 0.001 * number,
        "queries": 10 * number,
        "seconds": 1.0,
    }
    fields = dict.fromkeys(CASE_FIELDS, "") | {"scene": scene, "azimuth": azimuth, "target": "net", "attack": "image"}
    return CaseRow(number, f"id{number}", fields, Case(**(values | changed)))


HELD = {"success": False, "outcome": "held"}


def test_a_cell_has_the_rate_of_its_counted_cases() -> None:
    cases = [row(1), row(2, **HELD), row(3, right=False), row(4, state="cancelled"), row(5, state="failed", **HELD)]
    made = grid([*cases, row(6, "sofa", "90°")], "scene", "azimuth", "success")
    assert (made.rows, made.columns) == (["chair", "sofa"], ["0°", "90°"])
    chair = made.cells["chair", "0°"]
    assert (chair.success.count, chair.success.of, chair.share) == (1, 3, pytest.approx(1 / 3))
    assert ("chair", "90°") not in made.cells


def test_a_mean_is_over_successes_and_shaded_from_least_to_most() -> None:
    cases = [row(1), row(3), row(9, **HELD), row(4, "sofa"), row(6, "desk"), row(7, "lamp", **HELD)]
    made = grid(cases, "scene", "azimuth", "queries")
    values = {scene: cell.value for (scene, _), cell in made.cells.items()}
    assert values == {"chair": 20, "sofa": 40, "desk": 60, "lamp": None}
    assert [made.cells[scene, "0°"].share for scene in ("chair", "sofa", "desk", "lamp")] == [0, 0.5, 1, 0]


def test_numbers_are_in_their_own_order() -> None:
    made = grid([row(1, azimuth="120°"), row(2, azimuth="30°"), row(3, azimuth="9°")], "scene", "azimuth", "success")
    assert made.columns == ["9°", "30°", "120°"]


def test_best_and_worst_cases() -> None:
    cases = [row(3), row(1), row(2), row(8, **HELD), row(9, **HELD), row(7, right=False)]
    assert [one.number for one in best(cases, 2)] == [1, 2]
    assert [one.number for one in worst(cases, 4)] == [9, 8, 3, 2]


def test_the_lines_have_every_case_and_no_formula() -> None:
    cases = [row(1, scene="=1+1"), row(2, perceptibility=None, state="cancelled")]
    first, second = csv.DictReader(io.StringIO(cases_to_csv(cases)))
    assert (first["scene"], first["job"], first["first_answer"]) == ("'=1+1", "id1", "")
    assert (float(first["perceptibility"]), first["queries"]) == (0.001, "10")
    assert (second["perceptibility"], second["state"]) == ("", "cancelled")
