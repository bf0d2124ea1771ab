import pytest

from api.dashboard.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, chart
from api.dashboard.views import charts, trace_of_events
from services.jobs.models import Event
from tests.unit.api.dashboard_records import row


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
