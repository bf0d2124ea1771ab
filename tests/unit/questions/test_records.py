"""The functions of a question whose attention changed."""

from scene_attack_questions.records import Attended, first_changed, most_changed


def attention(*changes: tuple[float, float]) -> list[Attended]:
    """Functions 3, 4, … whose attention changed by so much, and at a cell."""
    return [
        Attended(node=3 + k, before="", after="", change=change, cell_change=at_a_cell)
        for k, (change, at_a_cell) in enumerate(changes)
    ]


def test_the_first_change_is_the_first_at_a_cell() -> None:
    """Many small changes of cells are not another object."""
    found = first_changed(attention((0.1, 0.1), (6.0, 0.49), (0.5, 0.5), (2.0, 0.9)))
    assert found is not None
    assert found.node == 5
    assert first_changed(attention((9.0, 0.49))) is None
    assert first_changed([]) is None


def test_the_largest_change_is_the_first_of_equal_ones() -> None:
    found = most_changed(attention((0.1, 0.1), (2.0, 0.4), (0.3, 0.3), (2.0, 0.9)))
    assert found is not None
    assert found.node == 4
    assert most_changed(attention((0.0, 0.0), (0.0, 0.0))) is None
    assert most_changed([]) is None
