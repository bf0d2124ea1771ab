"""The words of questions, and how a program differs from them."""

import pickle

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack_questions.program import Node, Program
from scene_attack_questions.text import MAX_WORDS, WORDS, UnknownWord, difference, encoded, tokens

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
    assert [WORDS[index] for index in encoded(text)] == tokens(text)
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


def test_questions_of_the_language_agree_with_their_programs(asked) -> None:
    for _, questions in asked:
        for question in questions:
            assert difference(question.question, question.program) is None, question.question


def test_questions_agree_with_no_program_that_names_something_else(asked) -> None:
    instead = {"red": "blue", "blue": "red", "cube": "sphere", "left": "right", "large": "small", "metal": "rubber"}
    damaged = 0
    for _, questions in asked[:40]:
        for question in questions:
            nodes = question.program.nodes
            for k, node in enumerate(nodes):
                if node.values and node.values[0] in instead:
                    other = Node(node.function, node.inputs, (instead[node.values[0]],))
                    assert difference(question.question, Program((*nodes[:k], other, *nodes[k + 1 :])))
                    damaged += 1
    assert damaged > 300


SCENE, CUBE = Node("scene", (), ()), Node("filter_shape", (0,), ("cube",))
MADE: list[tuple[str, str, tuple[Node, ...]]] = [
    (
        "What is left of the cube?",
        "'left' once, the program 0 times",
        (SCENE, CUBE, Node("unique", (1,), ()), Node("query_material", (2,), ())),
    ),
    (
        "How many cubes or balls are there?",
        "'cube' once, the program 2 times",
        (
            *(SCENE, CUBE, SCENE, Node("filter_shape", (2,), ("sphere",)), Node("union", (1, 3), ())),
            *(Node("filter_shape", (4,), ("cube",)), Node("count", (5,), ())),
        ),
    ),
    (
        "Is the block shiny or matte?",
        "the question no 'fewer' or 'less'",
        (
            *(SCENE, Node("filter_material", (0,), ("metal",)), Node("filter_shape", (1,), ("cube",))),
            *(Node("count", (2,), ()), SCENE, Node("filter_material", (4,), ("rubber",)), Node("count", (5,), ())),
            Node("less_than", (3, 6), ()),
        ),
    ),
    ("Is there a cube?", "the question no 'many' or 'number'", (SCENE, CUBE, Node("count", (1,), ()))),
]


@pytest.mark.parametrize(("question", "words", "nodes"), MADE, ids=[one[0] for one in MADE])
def test_what_the_shipped_generator_made_of_questions_that_are_none_of_the_language(
    question: str, words: str, nodes: tuple[Node, ...]
) -> None:
    found = difference(question, Program(nodes))
    assert found is not None
    assert words in found


def test_other_words_for_the_same_are_no_difference() -> None:
    assert difference("Is there a large shiny block?", _exist("large", "metal", "cube")) is None
    assert difference("is there a big metallic cube", _exist("large", "metal", "cube")) is None


def _exist(size: str, material: str, shape: str) -> Program:
    chosen = [("filter_size", size), ("filter_material", material), ("filter_shape", shape)]
    filters = (Node(name, (k,), (value,)) for k, (name, value) in enumerate(chosen))
    return Program((SCENE, *filters, Node("exist", (3,), ())))
