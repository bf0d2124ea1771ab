"""Work to a verified adversary: rates, medians and their intervals, with failures censored."""

import dataclasses
from math import inf

import pytest

from services.accuracy.work_precision import attacks
from services.accuracy.work_precision.attacks import SCENES, AttackRow, Success, successes


def attacked(outcome: str, queries: int) -> AttackRow:
    return AttackRow.model_validate(
        {
            "scene": "s",
            "label": "l",
            "renderer": "torch",
            "method": "fgsm",
            "groups": ("normals",),
            "tolerance": 1e-3,
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


def test_all_work_is_counted() -> None:
    """Fooled in the loop only is not a success, nor is a scene that was wrong to begin with an attack."""
    runs = [
        attacked("verified", 7),
        attacked("held", 20),
        attacked("fooled in the loop only", 20),
        attacked("verified", 3),
    ]
    [made] = successes([*runs, attacked("wrong to begin with", 0)])
    assert (made.verified, len(made.attacks)) == (2, 4)
    assert made.median("queries") == 7


@pytest.mark.parametrize(
    ("outcomes", "median"),
    [("vvv", 2), ("vhvv", 3), ("vhh", inf), ("v", 1)],
)
def test_medians_of_censored_values(outcomes: str, median: float) -> None:
    """The lower of the middle two; none where more than half hold."""
    words = {"v": "verified", "h": "held"}
    rows = [attacked(words[outcome], queries) for queries, outcome in enumerate(outcomes, 1)]
    assert Success(rows).median("queries") == median


def test_there_are_enough_scenes() -> None:
    assert len(dict.fromkeys(SCENES)) == len(SCENES) >= 20
