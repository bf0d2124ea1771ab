from random import Random

import pytest

from scene_attack_questions.iep.program_generator import TOKENS, from_prefix, to_prefix
from scene_attack_questions.program import InvalidProgram
from tests.unit.questions.iep import world

COMPARED = [
    "equal_color",
    *["query_color", "unique", "scene"],
    *["query_color", "unique", "filter_size[small]", "scene"],
]


def test_there_is_a_token_for_each_function_and_value() -> None:
    assert len(TOKENS) == len(set(TOKENS)) == 38 + 2


def test_a_sequence_is_read_with_the_root_last() -> None:
    program = from_prefix(COMPARED)
    assert [node.label for node in program.nodes] == [*COMPARED[3:0:-1], *COMPARED[7:3:-1], COMPARED[0]]
    assert program.nodes[-1].inputs == (2, 6)


def test_programs_come_back() -> None:
    random = Random(4)
    things = world.scene(random)
    for number in range(80):
        program, results = world.question(random, things, world.FAMILIES[number % 8])
        again = from_prefix(to_prefix(program))
        assert to_prefix(again) == to_prefix(program)
        assert world.run(things, again)[-1] == results[-1]


@pytest.mark.parametrize(
    ("tokens", "reason"),
    [
        ([], "form"),
        (COMPARED[:-1], "form"),
        ([*COMPARED, "scene"], "form"),
        (["count"] * 65, "form"),
        (["count", "filter_color"], "function"),
        (["count", "filter_color[mauve]", "scene"], "function"),
        (["count", "unique", "scene"], "type"),
        (["equal_integer", "count", "scene", "exist", "scene"], "type"),
        (["filter_color[red]", "scene"], "root"),
    ],
)
def test_what_is_no_program_is_a_typed_error(tokens: list[str], reason: str) -> None:
    with pytest.raises(InvalidProgram) as error:
        from_prefix(tokens)
    assert error.value.reason == reason
