from services.pipeline.question_record import Attended, first_changed, most_changed


def changed(*changes: float) -> list[Attended]:
    """Functions 3, 4, … whose attention changed by so much."""
    return [Attended(node=3 + k, before="", after="", change=change) for k, change in enumerate(changes)]


def test_the_first_change_is_the_first_of_half_an_object() -> None:
    found = first_changed(changed(0.1, 0.49, 0.5, 2.0))
    assert found is not None
    assert found.node == 5
    assert first_changed(changed(0.1, 0.49)) is None
    assert first_changed([]) is None


def test_the_largest_change_is_the_first_of_equal_ones() -> None:
    found = most_changed(changed(0.1, 2.0, 0.3, 2.0))
    assert found is not None
    assert found.node == 4
    assert most_changed(changed(0.0, 0.0)) is None
    assert most_changed([]) is None
