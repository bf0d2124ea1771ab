import pytest

from services.text import did_you_mean, sound


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


@pytest.mark.parametrize(("name", "meant"), [("fiziks", "physics"), ("pyannow", "furniture/piano")])
def test_a_name_that_sounds_alike_is_suggested_though_it_is_spelt_otherwise(name: str, meant: str) -> None:
    known = ["matte", meant, "furniture/lamp", "primitive/sphere"]
    assert did_you_mean(name, known) == f"; did you mean {meant!r}?"


def test_names_that_sound_alike_differ_in_no_class_of_consonants() -> None:
    assert sound("Robert") == sound("rupert") == "6163"
    assert sound("graph") == sound("graf")
    assert sound("sofa1") != sound("sofa2")


def test_a_name_that_sounds_alike_takes_the_place_of_the_third_in_spelling() -> None:
    known = ["fizikal", "fizika", "fizikb", "physiks"]
    assert did_you_mean("fiziks", known).endswith("or 'physiks'?")
    assert did_you_mean("fiziks", known).count("'") == 6
