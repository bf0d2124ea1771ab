"""What a program asks is compared with what its question says."""

import pytest

from services.questions.program import Node, Program
from services.questions.text import difference


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
