import json

import pytest

from scene_attack.strict import NotJson, read_json

WRONG = {
    "nothing": ("", "a value of JSON is missing at line 1, column 1"),
    "half an object": ('{"a"', "a colon is missing"),
    "half a list": ("[1", "a comma or a closing bracket is missing at line 1, column 3"),
    "no quotation mark": ('{"a": "x', "a text has no closing quotation mark; it begins at line 1, column 7"),
    "on another line": ('{\n"a" 1}', "at line 2, column 5"),
    "an escape that is none": ('"\\q"', "a backslash that begins no escape"),
    "two texts": ("{}{}", "something follows its end at line 1, column 3"),
    "no UTF-8": (b'"\xff"', "it is not UTF-8 text: byte 2 cannot be"),
    "a long number": ("9" * 5000, "it has a number of more than 4,300 digits"),
    "a list of lists": ("[" * 66 + "]" * 66, "it is nested deeper than 64 lists and objects"),
    "one without an end": ("[" * 200_000, "it is nested deeper than 64 lists and objects"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_is_said_in_words(name: str) -> None:
    text, said = WRONG[name]
    with pytest.raises(NotJson) as raised:
        read_json(text)
    assert said in str(raised.value)


@pytest.mark.parametrize("text", ['{"a": [1, null]}', b'\xef\xbb\xbf{"a": [1, null]}', '\ufeff{"a": [1, null]}'])
def test_what_is_right_is_read(text: str | bytes) -> None:
    assert read_json(text) == {"a": [1, None]}


ENDS = ("", "{", '{"a"', '{"a":', '{"a":1', '{"a":1,}', "[1,]", "[1", '"x', '"\x01"', '"\\q"', '"\\u12"', "{}{}")


@pytest.mark.parametrize("text", ENDS)
def test_no_message_of_the_parser_itself_is_shown(text: str) -> None:
    """Another release of Python may say other things, for which there are no words yet."""
    with pytest.raises(json.JSONDecodeError) as raised:
        json.loads(text)
    with pytest.raises(NotJson) as said:
        read_json(text)
    assert raised.value.msg not in str(said.value)
