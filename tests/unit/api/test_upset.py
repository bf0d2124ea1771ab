"""The layout of the UpSet plot."""

import pytest

from api.dashboard.charts import BAR, COLUMN, GROUPS_WIDTH, SHAPLEY, ZERO, upset
from tests.unit.api.dashboard_records import ATTRIBUTION

WORDS = {"normals": "surface normals", "illumination": "illumination"}
FILES = ["original.png", "attacked.png", "subset-1.png"]
SUBSETS = [
    {"groups": groups, "outcome": outcome, "goal_probability": p, "fooled": outcome == "fooled"}
    for groups, outcome, p in (
        ([], "held", 0.8),
        (["normals"], "held", 0.5),
        (["illumination"], "held", 0.6),
        (["normals", "illumination"], "fooled", 0.25),
    )
]


def test_a_column_has_the_image_bar_and_dots_of_its_subset() -> None:
    made = upset(SUBSETS, ATTRIBUTION, WORDS, FILES)
    assert made is not None
    assert [one.image for one in made.columns] == ["original.png", "subset-1.png", "", "attacked.png"]
    assert [(made.bars - one.top) / BAR for one in made.columns] == pytest.approx([0.8, 0.5, 0.6, 0.25])
    first, second = (group.y for group in made.groups)
    assert [one.dots for one in made.columns] == [
        [(first, a), (second, b)] for a, b in ((False, False), (True, False), (False, True), (True, True))
    ]
    assert [one.line for one in made.columns] == [None, None, None, (first, second)]
    assert [one.met for one in made.columns] == [False, False, False, True]
    assert made.columns[1].words == "surface normals"
    assert made.columns[3].words == "surface normals + illumination"
    assert made.columns[3].x + COLUMN / 2 == made.width
    assert made.columns[0].x - COLUMN / 2 == GROUPS_WIDTH
    without = upset(SUBSETS, ATTRIBUTION, WORDS, [])
    assert without is not None
    assert {one.image for one in without.columns} == {""}


def test_bars_of_shapley_values_leave_zero_to_either_side() -> None:
    attribution = ATTRIBUTION | {"log_odds": {"shapley": [-2.0, 0.5]}}
    made = upset(SUBSETS, attribution, WORDS, FILES)
    assert made is not None
    longest, short = made.groups
    assert (longest.start, longest.width) == (ZERO - SHAPLEY, SHAPLEY)
    assert (short.start, short.width) == (ZERO, SHAPLEY / 4)


def test_of_one_group_there_is_nothing_to_tell() -> None:
    assert upset(SUBSETS[:2], ATTRIBUTION, {"normals": "surface normals"}, FILES) is None
