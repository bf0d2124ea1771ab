"""The executor against brute force in predicate logic, on generated questions and on damaged ones."""

import pickle

import pytest

from services.errors import InvalidRequest
from services.questions.executor import IllPosed, answer, execute
from services.questions.facts import Facts
from services.questions.program import InvalidProgram, Node, Program
from services.scenes.clevr.generator import generate


@pytest.mark.parametrize(("color", "found"), [("red", 0), ("blue", 2)])
def test_a_unique_of_none_or_many_is_ill_posed(color: str, found: int) -> None:
    scene = generate(0, 0, objects=(3, 3))
    objects = tuple(
        one.model_copy(update={"color": name})
        for one, name in zip(scene.objects, ("blue", "cyan", "blue"), strict=True)
    )
    facts = Facts.of(scene.model_copy(update={"objects": objects}))
    program = chain(("scene",), ("filter_color", color), ("unique",), ("query_size",))
    with pytest.raises(IllPosed) as caught:
        execute(program, facts)
    assert (caught.value.node, caught.value.found, caught.value.field) == (2, found, "program.2")
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.node, again.found, str(again)) == (2, found, str(caught.value))


def test_every_node_s_output_is_returned() -> None:
    scene = generate(0, 1)
    red = frozenset(k for k, one in enumerate(scene.objects) if one.color == scene.objects[0].color)
    program = chain(("scene",), ("filter_color", scene.objects[0].color), ("count",))
    assert execute(program, Facts.of(scene)) == (frozenset(range(len(scene.objects))), red, len(red))


def test_an_invalid_program_is_not_executed() -> None:
    with pytest.raises(InvalidProgram):
        execute(chain(("scene",)), Facts.of(generate(0, 0)))


def test_a_count_above_ten_is_no_answer() -> None:
    scene = generate(0, 0)
    unrelated = dict.fromkeys(scene.relationships, ((),) * 11)
    many = scene.model_copy(update={"objects": scene.objects[:1] * 11, "relationships": unrelated})
    with pytest.raises(InvalidRequest, match="11"):
        answer(chain(("scene",), ("count",)), Facts.of(many))


def chain(*calls: tuple[str, ...]) -> Program:
    """A program in which each call takes the one before it."""
    nodes = [Node(name, (k - 1,) if k else (), tuple(values)) for k, (name, *values) in enumerate(calls)]
    return Program(tuple(nodes))
