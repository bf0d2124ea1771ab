"""The layout of charts: curves, UpSet plots and polar plots."""

import pytest

from scene_attack_api.dashboard.charts import (
    BAR,
    BOTTOM,
    COLUMN,
    GROUPS_WIDTH,
    HEIGHT,
    LEFT,
    RADIUS,
    RIGHT,
    SHAPLEY,
    TOP,
    WIDTH,
    ZERO,
    chart,
    polar,
    upset,
)
from scene_attack_api.dashboard.views import charts, trace_of_events
from scene_attack_service.jobs.models import Event
from tests.unit.api.dashboard_records import ATTRIBUTION, row


def coordinates(path: str | None) -> list[tuple[float, float]]:
    assert path is not None
    pairs = [pair.split() for pair in path.removeprefix("M").split(" L")]
    return [(float(x), float(y)) for x, y in pairs]


def test_a_line_fills_the_frame_corner_to_corner() -> None:
    made = chart("t", "step", [(0, 0.0), (5, 0.5), (10, 1.0)])
    assert coordinates(made.paths[0]) == [
        (LEFT, HEIGHT - BOTTOM),
        ((LEFT + WIDTH - RIGHT) / 2, (TOP + HEIGHT - BOTTOM) / 2),
        (WIDTH - RIGHT, TOP),
    ]


def test_ticks_are_round_and_lie_where_the_curve_has_their_values() -> None:
    made = chart("t", "step", [(0, -0.3), (120, 4.4)], threshold=0)
    assert [tick.text for tick in made.y_ticks] == ["0", "2", "4"]
    assert made.threshold == pytest.approx(made.y_ticks[0].at, abs=0.05)
    assert [tick.text for tick in made.x_ticks] == ["0", "50", "100"]
    share = (made.x_ticks[1].at - LEFT) / (WIDTH - RIGHT - LEFT)
    assert share == pytest.approx(50 / 120, abs=0.001)


@pytest.mark.parametrize(("last", "texts"), [(1, ["0", "1"]), (2, ["0", "1", "2"]), (12, ["0", "5", "10"])])
def test_a_step_is_a_whole_number(last: int, texts: list[str]) -> None:
    made = chart("t", "step", [(step, 0.5) for step in range(last + 1)], whole=True)
    assert [tick.text for tick in made.x_ticks] == texts


def test_the_rounding_of_an_unchanged_image_looks_like_nothing() -> None:
    """In its first row a trace has the distance that rounding leaves, 1e-6, and would fill the chart with it."""
    curves = charts([row(0, distance=1e-6, perceptibility=1e-11)], {"goal": {}}, "step")
    assert [tick.text for tick in curves[3].y_ticks] == ["0", "0.005", "0.01"]
    assert curves[3].last is not None
    assert curves[3].last[1] == pytest.approx(HEIGHT - BOTTOM, abs=0.1)
    assert [tick.text for tick in curves[0].x_ticks] == ["0", "1"]


@pytest.mark.parametrize("value", [0.0, 0.7, -3e-9, 1e12])
def test_a_single_point_is_drawn_inside_the_frame(value: float) -> None:
    last = chart("t", "step", [(0, value)]).last
    assert last is not None
    x, y = last
    assert LEFT <= x <= WIDTH - RIGHT
    assert TOP <= y <= HEIGHT - BOTTOM


def test_a_long_curve_is_thinned_without_losing_its_spike() -> None:
    points = [(float(i), 1.0) for i in range(10_000)]
    points[6_789] = (6_789.0, 50.0)
    made = chart("t", "step", points)
    drawn = coordinates(made.paths[0])
    assert len(drawn) <= 402
    assert min(y for _, y in drawn) == TOP
    assert drawn[-1][0] == WIDTH - RIGHT


def test_steps_told_twice_count_as_told_last() -> None:
    def event(*rows: dict[str, object]) -> Event:
        return Event(kind="progress", data={"rows": list(rows)})

    events = [
        Event(kind="state", data={"state": "running"}),
        event(row(0), row(1), row(2), row(3)),
        event(row(2, loss=0.5)),  # the next attempt took up a checkpoint of step 2
        event(row(3, loss=0.25)),
    ]
    rows = trace_of_events(events)
    assert [r["step"] for r in rows] == [0, 1, 2, 3]
    assert [r["loss"] for r in rows[2:]] == [0.5, 0.25]


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


def test_the_largest_value_of_both_has_the_radius() -> None:
    made = polar({"name": "red", "angles": [-90.0, 0.0, 90.0], "before": [1.0, 2.0, 1.0], "after": [0.0, 4.0, 2.0]})
    assert made.largest == 4
    assert made.after == f"M0 0 L0 0 L0 -{RADIUS:g} L{RADIUS / 2:g} 0 Z"
    assert made.before == f"M0 0 L-{RADIUS / 4:g} 0 L0 -{RADIUS / 2:g} L{RADIUS / 4:g} 0 Z"
    assert made.rows[1] == (0.0, 2.0, 4.0)


def test_nothing_reflected_is_a_point() -> None:
    made = polar({"name": "red", "angles": [0.0], "before": [0.0], "after": [0.0]})
    assert made.before == "M0 0 L0 0 Z"
