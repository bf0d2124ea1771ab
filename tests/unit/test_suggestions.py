import pytest

from services.text import did_you_mean


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("plastik", "; did you mean 'plastic'?"),
        ("glossy", "; did you mean 'glossy-paint'?"),
        ("zzz", ""),
        ("", ""),
    ],
)
def test_close_names_are_suggested(name: str, said: str) -> None:
    assert did_you_mean(name, ("matte", "plastic", "glossy-paint", "brushed-metal")) == said


def test_the_closest_come_first_and_three_at_most() -> None:
    assert did_you_mean("chair", ("chairs", "chair1", "chair12", "chair123")).count("chair") == 3
    assert did_you_mean("sofaa", ("sofa1", "sofa")) == "; did you mean 'sofa' or 'sofa1'?"
