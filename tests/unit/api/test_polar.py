"""The layout of polar plots."""

from api.dashboard.charts import RADIUS, polar


def test_the_largest_value_of_both_has_the_radius() -> None:
    made = polar({"name": "red", "angles": [-90.0, 0.0, 90.0], "before": [1.0, 2.0, 1.0], "after": [0.0, 4.0, 2.0]})
    assert made.largest == 4
    assert made.after == f"M0 0 L0 0 L0 -{RADIUS:g} L{RADIUS / 2:g} 0 Z"
    assert made.before == f"M0 0 L-{RADIUS / 4:g} 0 L0 -{RADIUS / 2:g} L{RADIUS / 4:g} 0 Z"
    assert made.rows[1] == (0.0, 2.0, 4.0)


def test_nothing_reflected_is_a_point() -> None:
    made = polar({"name": "red", "angles": [0.0], "before": [0.0], "after": [0.0]})
    assert made.before == "M0 0 L0 0 Z"
