"""Means of Shapley values over jobs, computed by hand."""

from math import sqrt
from typing import Any

import pytest

from scene_attack.analysis.campaign_table import part_means
from scene_attack.analysis.verdict import NORMAL_95


def attribution(**values: float) -> dict[str, Any]:
    return {"parts": list(values), "log_odds": {"shapley": list(values.values())}}


def test_the_mean_its_interval_and_how_often_a_part_came_first() -> None:
    jobs = [
        ("net", "all", attribution(normals=-3.0, lights=1.0)),
        ("net", "all", attribution(normals=-1.0, lights=2.0)),
        ("net", "one", attribution(normals=-4.0)),
    ]
    normals, lights, single = part_means(jobs)
    assert (normals.part, normals.value, normals.first, normals.jobs) == ("normals", -2.0, 1, 2)
    assert normals.half == pytest.approx(NORMAL_95 * sqrt(2.0) / sqrt(2.0))  # deviations of ±1 around the mean
    assert (lights.value, lights.first) == (1.5, 1)
    assert (single.attack, single.half, single.first) == ("one", None, 1)
    assert part_means([]) == []
