import json

import pytest

from services.text import escaped, line, line_or_nothing, paragraphs, visible

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
