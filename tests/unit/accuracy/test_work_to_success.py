"""Work to a verified adversary: rates, medians and their intervals, with failures censored."""

import dataclasses
from math import inf

import numpy as np

from services.accuracy.work_precision import attacks
from services.accuracy.work_precision.attacks import SCENES, AttackRow, median_interval, success_rows


def attacked(outcome: str, queries: int) -> AttackRow:
    return AttackRow.model_validate(
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
            "max_steps": 9,
        }
    )


def test_a_scene_that_the_network_gets_wrong_is_a_row() -> None:
    [case, *_] = attacks.cases(1, 1, {"steps": 1})
    found = attacks.attack(dataclasses.replace(case, label="grand piano"))
    assert found.outcome == "wrong to begin with"
    assert found.queries == 0


def test_medians_of_censored_values() -> None:
    """The lower of the middle two; none where half or more hold; the interval of 24 equal values has no width."""
    assert median_interval([3.0, 1.0, 2.0]).median == 2
    assert median_interval([3.0, inf, 1.0, 2.0]).median == 2
    assert median_interval([1.0, inf, inf]).median is None
    same = median_interval([5.0] * 24)
    assert (same.low, same.high) == (5, 5)
    wide = median_interval([*map(float, range(1, 14)), *[inf] * 11])
    assert wide.median == 12
    assert wide.low is not None
    assert wide.low < 12
    assert wide.high is None


def test_bootstrap_intervals_cover_the_median() -> None:
    """95 % of the samples of a uniform distribution, by definition; 400 of 24 values, within four standard errors."""
    random = np.random.default_rng(7)
    held = 0
    for _ in range(400):
        found = median_interval(list(random.random(24)))
        assert found.low is not None
        assert found.high is not None
        held += found.low <= 0.5 <= found.high
    assert 0.906 < held / 400 < 0.994


def test_all_work_is_counted() -> None:
    """Fooled in the loop only is not a success, nor is a scene that was wrong to begin with an attack."""
    runs = [
        attacked("verified", 7),
        attacked("held", 20),
        attacked("fooled in the loop only", 20),
        attacked("verified", 3),
    ]
    [row] = success_rows([*runs, attacked("wrong to begin with", 0)])
    assert (row.verified, row.attacks, row.rate) == (2, 4, 0.5)
    assert row.queries_per_success == 25
    assert row.queries.median == 7
    assert row.queries.high is None


def test_there_are_enough_scenes() -> None:
    assert len(dict.fromkeys(SCENES)) == len(SCENES) >= 20
