import pytest

from scene_attack_questions.iep.assembly import COMPARING, JOINING, KINDS, MAPPING, READING, Question, assemble
from scene_attack_questions.program import InvalidProgram
from tests.unit.questions.iep.seeded import program

pytestmark = pytest.mark.slow


COUNT_RED = program("scene", "filter_color 0 red", "count 1")
ANY_RED_CUBE = program("scene", "filter_color 0 red", "filter_shape 1 cube", "exist 2")
MORE = program("scene", "filter_color 0 red", "filter_shape 1 cube", "count 2", "scene", "count 4", "greater_than 3 5")


def test_every_function_is_in_one_kind() -> None:
    assert [len(names) for names in (MAPPING, JOINING, READING, COMPARING)] == [15 + 4 + 4, 2, 6, 7]
    assert {"filter_color[red]", "relate[behind]", "same_size"} <= set(MAPPING)
    assert sum(len(names) for names in KINDS.values()) == 38


def test_levels_are_counted_from_the_roots() -> None:
    assembly = assemble([Question(MORE, 0), Question(COUNT_RED, 1)])
    kinds = [{kind: len(getattr(level, kind)) for kind in KINDS} for level in assembly.levels]
    assert kinds == [
        {"mapping": 1, "joining": 0, "reading": 0, "comparing": 0},
        {"mapping": 1, "joining": 0, "reading": 0, "comparing": 0},
        {"mapping": 1, "joining": 0, "reading": 2, "comparing": 0},
        {"mapping": 0, "joining": 0, "reading": 1, "comparing": 1},
    ]


def test_equal_subprograms_on_an_image_are_computed_once() -> None:
    def calls(*questions: Question) -> int:
        return sum(len(getattr(level, kind)) for level in assemble(questions).levels for kind in KINDS)

    assert calls(Question(COUNT_RED), Question(COUNT_RED)) == 2
    assert calls(Question(COUNT_RED), Question(ANY_RED_CUBE)) == 2 + 3 - 1
    assert calls(Question(COUNT_RED, 0), Question(COUNT_RED, 1)) == 4
    same = assemble([Question(COUNT_RED), Question(COUNT_RED)])
    assert same.slots[0] == same.slots[1]


def test_what_is_no_program_is_refused() -> None:
    with pytest.raises(InvalidProgram):
        assemble([Question(COUNT_RED), Question(program("scene", "query_color 0"))])
    with pytest.raises(InvalidProgram):
        assemble([Question(program("scene"))])
    with pytest.raises(ValueError, match="question"):
        assemble([])
    with pytest.raises(ValueError, match="numbered"):
        assemble([Question(COUNT_RED, -1)])
