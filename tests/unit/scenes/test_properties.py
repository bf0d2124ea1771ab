"""The .properties reader against an independent writer of Java's rules."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.scenes.furniture import parse_properties


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"name#1=Armchair", {"name#1": "Armchair"}),
        (b"  name : Chair \n", {"name": "Chair "}),
        (b"name Chair", {"name": "Chair"}),
        (b"# a=b\n! c=d\n\nempty=\nalone", {"empty": "", "alone": ""}),
        (b"a=one, \\\n   two\\\r\n  three", {"a": "one, twothree"}),
        (b"path=c\\:\\\\x\\ty", {"path": "c:\\x\ty"}),
        (b"a\\=b\\ c=d", {"a=b c": "d"}),
        (b"caf\xe9=\\u00e9\\u20AC", {"café": "é€"}),
        (b"a=1\na=2", {"a": "2"}),
        (b"a=x\\\\\nb=y", {"a": "x\\", "b": "y"}),
        (b"a=b=c:d", {"a": "b=c:d"}),
        (b"", {}),
    ],
)
def test_reads_javas_rules(text, expected):
    assert parse_properties(text) == expected


def escape(text, key):
    out = []
    for index, character in enumerate(text):
        if character in "\\=:#!" or (character == " " and (key or index == 0)):
            out.append("\\" + character)
        elif character in "\t\n\r\f":
            out.append({"\t": "\\t", "\n": "\\n", "\r": "\\r", "\f": "\\f"}[character])
        elif " " <= character <= "~":
            out.append(character)
        else:
            out.append(f"\\u{ord(character):04x}")
    return "".join(out)


words = st.text(st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"]), max_size=12)


@given(st.dictionaries(words, words, max_size=6))
def test_reads_back_what_java_would_write(values):
    text = "\n".join(f"{escape(key, True)}={escape(value, False)}" for key, value in values.items())
    assert parse_properties(text.encode("latin-1")) == values


@given(st.binary(max_size=200))
def test_no_bytes_break_it(data):
    assert all(isinstance(value, str) for value in parse_properties(data).values())
