"""The page on light and material says what the committed result says, and the calibration attacks what it says."""

import pytest

from benchmarks.units import TARGETS, campaign, columns, content, meshes
from benchmarks.units_page import PAGE, page
from services.analysis.campaign_table import Case


def test_the_page_is_written_from_the_result() -> None:
    assert PAGE.read_text("utf-8") == page(), "write it again with: python -m benchmarks.units_page"


def test_a_larger_unit_is_a_smaller_rate() -> None:
    """In the renderer's own units, M = 10 and 30 per logarithm, the rate is the paper's 0.003."""
    rates = {
        one["name"]: next(iter(one["attack"]["learning_rate"].values()))
        for one in columns(120)
        if "learning_rate" in one["attack"]
    }
    assert rates["illumination, unit 10"] == pytest.approx(0.003)
    assert rates["illumination_rgb, unit 10"] == pytest.approx(0.003)
    assert rates["material, unit 30"] == pytest.approx(0.003)
    assert rates["illumination, unit 1"] == pytest.approx(0.03)
    assert rates["material, unit 10"] == pytest.approx(0.009)


def test_every_network_has_its_own_views_and_all_columns() -> None:
    scenes = {"material": "plastic", "camera": {"size": [448, 448]}, "views": {"random": 4, "seed": 0}}
    asked = campaign({name: meshes(name) for name in TARGETS}, columns(120), scenes, 30)
    assert [grid.targets[0].name for grid in asked.grids] == list(TARGETS)
    assert all(grid.count() >= 2 * 30 for grid in asked.grids[:2])
    assert all(
        [column.name for column in grid.attacks] == [one["name"] for one in columns(120)] for grid in asked.grids
    )
    assert all(grid.selection.right and grid.selection.most == 30 for grid in asked.grids)


def test_figures_are_of_each_network_and_column() -> None:
    ended = {"state": "succeeded", "right": True}
    cases = [
        Case(target="a", attack="normals", success=True, perceptibility=0.01, truncated=4, run_seconds=2.0, **ended),
        Case(target="a", attack="normals", truncated=0, run_seconds=4.0, **ended),
        Case(target="b", attack="normals", truncated=1, run_seconds=9.0, **ended),
    ]
    found = content(cases)
    first, second = found["rows"]
    assert (first["target"], first["success"]["count"], first["success"]["of"]) == ("a", 1, 2)
    assert (first["perceptibility"], first["truncated"], first["run_seconds"]) == (0.01, 2.0, 3.0)
    assert (second["target"], second["success"]["count"], second["perceptibility"]) == ("b", 0, None)
    assert (found["ended"], found["run_seconds"]) == (3, 15.0)
