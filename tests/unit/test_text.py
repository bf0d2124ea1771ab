"""Texts that people write, numbers with signs, and names that are close to a wrong one."""

import json
import re
from pathlib import Path

import pytest

from scene_attack.text import did_you_mean, escaped, line, line_or_nothing, paragraphs, signed, visible

OVERRIDES = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
STEERING = ["\0", "\x1b", "\x07", "\r", "\x7f", "\x85", "\x9b", *OVERRIDES]


@pytest.mark.parametrize("character", STEERING)
def test_what_steers_a_terminal_is_in_no_text(character: str) -> None:
    for check in (line, line_or_nothing, paragraphs):
        with pytest.raises(ValueError, match=rf"U\+{ord(character):04X}; a (line of )?text has no control characters"):
            check(f"a{character}b")
    assert visible(f"a{character}b") == "a\ufffdb"
    text = json.dumps({"title": f"a{character}b"}, ensure_ascii=False)
    assert character not in escaped(text)
    assert json.loads(escaped(text)) == json.loads(text)


@pytest.mark.parametrize("character", ["\n", "\t", "\u2028", "\u2029"])
def test_a_line_is_one_line_and_a_note_may_be_several(character: str) -> None:
    with pytest.raises(ValueError, match=rf"U\+{ord(character):04X}"):
        line(f"a{character}b")
    assert paragraphs(f"a{character}b") == visible(f"a{character}b") == f"a{character}b"


@pytest.mark.parametrize("text", [" ", "\u00a0 \u3000", "\u200b", "\u2060\ufeff"])
def test_a_name_can_be_seen(text: str) -> None:
    for check in (line, line_or_nothing):
        with pytest.raises(ValueError, match="it is blank"):
            check(text)


def test_other_texts_stay_as_they_are() -> None:
    """Letters of every script, marks that join them, and marks of direction that override nothing."""
    for text in ("grand piano", "café №5", "نقطة", "क्ष", "👩\u200d🚀", "a\u00a0b", "\u200fا"):
        assert line(text) == line_or_nothing(text) == paragraphs(text) == visible(text) == escaped(text) == text
    assert line_or_nothing("") == ""
    with pytest.raises(ValueError, match="blank"):
        line("")


ROOT = Path(__file__).parents[2]
FORMATS = re.compile(r"%\+\.\d|:\+\.\d")


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (-0.0004, ".3f", "+0.000"),
        (-0.0, ".3g", "+0"),
        (-0.004, ".2f", "+0.00"),
        (-0.0006, ".3f", "-0.001"),
        (0.1204, ".3f", "+0.120"),
        (-12345.0, ".3g", "-1.23e+04"),
    ],
)
def test_what_rounds_to_zero_has_no_minus(value: float, form: str, shown: str) -> None:
    assert signed(value, form) == shown


def test_no_table_writes_signs_itself() -> None:
    files = [
        one
        for room in ("api", "client", "services")
        for one in (ROOT / room).rglob("*")
        if one.suffix in (".py", ".html")
    ]
    assert len(files) > 300
    assert [str(one.relative_to(ROOT)) for one in files if FORMATS.search(one.read_text("utf-8"))] == []


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
