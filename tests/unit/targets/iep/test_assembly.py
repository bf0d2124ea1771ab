import pytest

from services.questions.program import InvalidProgram, Node, Program
from services.targets.iep.assembly import COMPARING, JOINING, KINDS, MAPPING, READING, Question, assemble

pytestmark = pytest.mark.slow


def program(*nodes: tuple[str, tuple[int, ...], str]) -> Program:
    return Program(tuple(Node(function, inputs, (value,) if value else ()) for function, inputs, value in nodes))


COUNT_RED = program(("scene", (), ""), ("filter_color", (0,), "red"), ("count", (1,), ""))
ANY_RED_CUBE = program(
    ("scene", (), ""), ("filter_color", (0,), "red"), ("filter_shape", (1,), "cube"), ("exist", (2,), "")
)
MORE = program(
    ("scene", (), ""),
    ("filter_color", (0,), "red"),
    ("filter_shape", (1,), "cube"),
    ("count", (2,), ""),
    ("scene", (), ""),
    ("count", (4,), ""),
    ("greater_than", (3, 5), ""),
)


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


def test_inputs_are_computed_before_they_are_taken() -> None:
    assembly = assemble([Question(one, image) for one in (MORE, ANY_RED_CUBE, COUNT_RED) for image in (0, 1)])
    maps, vectors = {0: 2}, dict[int, int]()
    for level in assembly.levels:
        for call in (*level.mapping, *level.joining, *level.reading):
            assert all(slot.row < maps[slot.stack] and slot.image == call.image for slot in call.inputs)
        for call in level.comparing:
            assert all(slot.row < vectors[slot.stack] for slot in call.inputs)
        if new := len(level.mapping) + len(level.joining):
            maps[len(maps)] = new
        if new := len(level.reading) + len(level.comparing):
            vectors[len(vectors)] = new


def test_equal_subprograms_on_an_image_are_computed_once() -> None:
    def calls(*questions: Question) -> int:
        return sum(len(getattr(level, kind)) for level in assemble(questions).levels for kind in KINDS)

    assert calls(Question(COUNT_RED), Question(COUNT_RED)) == 2
    assert calls(Question(COUNT_RED), Question(ANY_RED_CUBE)) == 2 + 3 - 1
    assert calls(Question(COUNT_RED, 0), Question(COUNT_RED, 1)) == 4
    same = assemble([Question(COUNT_RED), Question(COUNT_RED)])
    assert same.slots[0] == same.slots[1]


def test_unique_passes_its_input_on() -> None:
    what = program(("scene", (), ""), ("unique", (0,), ""), ("query_color", (1,), ""))
    slots = assemble([Question(what)]).slots[0]
    assert slots[0] == slots[1]


def test_what_is_no_program_is_refused() -> None:
    with pytest.raises(InvalidProgram):
        assemble([Question(COUNT_RED), Question(program(("scene", (), ""), ("query_color", (0,), "")))])
    with pytest.raises(InvalidProgram):
        assemble([Question(program(("scene", (), "")))])
    with pytest.raises(ValueError, match="question"):
        assemble([])
    with pytest.raises(ValueError, match="numbered"):
        assemble([Question(COUNT_RED, -1)])
