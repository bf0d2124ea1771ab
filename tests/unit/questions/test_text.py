"""Words of questions: what is known, and the first that is not."""

import pickle

import pytest

from services.errors import InvalidRequest
from services.questions.text import MAX_WORDS, WORDS, UnknownWord, decoded, encoded, tokens

CLEVR = """
    a an and another any anything are as big both color do does either else equal fewer greater has have how is it its
    less made many material more number of or other same shape size than that the there visible what thing things object
    objects cube cubes block blocks sphere spheres ball balls cylinder cylinders large small tiny metal metallic shiny
    rubber matte gray red blue green brown purple cyan yellow left right behind front in on side to ;
"""


def test_the_words_are_those_of_clevr_s_templates_and_synonyms() -> None:
    assert set(WORDS) == set(CLEVR.split())
    assert len(WORDS) == len(set(WORDS)) == 81


def test_a_text_is_split_into_words_and_semicolons() -> None:
    text = "There is a  tiny ball;\nwhat COLOR is it?"
    assert tokens(text) == ["there", "is", "a", "tiny", "ball", ";", "what", "color", "is", "it"]
    assert decoded(encoded(text)) == tokens(text)
    assert encoded("is it") == encoded("Is it?!")


@pytest.mark.parametrize(
    ("text", "word", "index"),
    [
        ("What colour is the Cubus?", "colour", 1),
        ("Are there Cubus, colour?", "Cubus", 2),
        ("How many cubes are there: 3?", "there:", 4),
        ("it's", "it's", 0),
        ("; é", "é", 1),
    ],
)
def test_the_first_unknown_word_is_named(text: str, word: str, index: int) -> None:
    with pytest.raises(UnknownWord) as caught:
        encoded(text)
    assert (caught.value.word, caught.value.index, caught.value.field) == (word, index, "question")
    assert repr(word) in caught.value.detail
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.word, again.index) == (word, index)


def test_an_unknown_word_is_compared_with_those_known() -> None:
    with pytest.raises(UnknownWord, match="did you mean 'color'"):
        encoded("What colour is it?")


@pytest.mark.parametrize("text", ["", " ?", "is " * (MAX_WORDS + 1)])
def test_no_words_or_too_many_are_refused(text: str) -> None:
    with pytest.raises(InvalidRequest, match="words; it needs 1 to 128"):
        encoded(text)
