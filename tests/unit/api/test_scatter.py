"""The layout of plots on logarithmic axes."""

import pytest

from api.dashboard.scatter import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, Point, scatter


def test_a_decade_has_the_same_length_everywhere() -> None:
    points = [Point(x, x, "") for x in (1e-3, 1e-2, 1e-1, 1.0)]
    plot = scatter("t", "x", "y", {"a": points})
    assert plot is not None
    xs, ys = [m.x for m in plot.series[0].marks], [m.y for m in plot.series[0].marks]
    width, height = (WIDTH - LEFT - RIGHT) / 3, (HEIGHT - TOP - BOTTOM) / 3
    assert xs == pytest.approx([LEFT + k * width for k in range(4)], abs=0.05)
    assert ys == pytest.approx([HEIGHT - BOTTOM - k * height for k in range(4)], abs=0.05)  # upwards
    assert [tick.text for tick in plot.x_ticks] == ["1e-3", "1e-2", "1e-1", "1"]


def test_what_has_no_logarithm_is_left_out_and_counted() -> None:
    plot = scatter("t", "x", "y", {"zero": [Point(1.0, 0.0, "")], "a": [Point(1.0, 2.0, "here"), Point(0.0, 1.0, "")]})
    assert plot is not None
    assert [(one.name, one.number, len(one.marks)) for one in plot.series] == [("a", 1, 1)]
    assert plot.left_out == 2
    assert scatter("t", "x", "y", {"zero": [Point(1.0, 0.0, "")]}) is None


def test_many_decades_have_few_ticks() -> None:
    plot = scatter("t", "x", "y", {"a": [Point(1e-30, 1.0, ""), Point(1.0, 1.0, "")]})
    assert plot is not None
    assert len(plot.x_ticks) <= 10
