"""The executor against brute force in predicate logic, on generated questions and on damaged ones; kinds of answers."""

import json
import pickle
from collections import Counter
from random import Random

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import ANSWERS, KINDS, Facts, IllPosed, answer, execute, kind_asked, kind_of
from scene_attack_questions.program import FUNCTIONS, InvalidProgram, Node, Program
from tests.unit.questions.brute_force import ILL_POSED, meaning


def as_json(scene: SceneRecord) -> dict:
    found = json.loads(scene.model_dump_json(by_alias=True))
    del found["relationships"]
    return found


def executed(program: Program, facts: Facts) -> str:
    try:
        return answer(program, facts)
    except IllPosed:
        return ILL_POSED


def test_generated_questions_have_the_answers_of_brute_force(asked) -> None:
    count = 0
    for scene, questions in asked:
        facts, written = Facts.of(scene), as_json(scene)
        for question in questions:
            found = meaning(question.program.written(), written)
            assert found == question.answer == answer(question.program, facts), question.question
            count += 1
    assert count > 5000


def test_programs_with_other_values_and_functions_have_the_meaning_of_brute_force(asked) -> None:
    random, outcomes = Random(0), Counter()
    for scene, questions in asked[::2]:
        facts, written = Facts.of(scene), as_json(scene)
        for question in questions:
            program = damaged(question.program, random)
            found = meaning(program.written(), written)
            assert executed(program, facts) == found, program
            outcomes[found] += 1
    assert outcomes[ILL_POSED] > 500
    assert outcomes.total() - outcomes[ILL_POSED] > 500


def damaged(program: Program, random: Random) -> Program:
    """The program with up to two calls exchanged for others of the same type: still valid, often ill-posed."""
    nodes = list(program.nodes)
    for k in random.sample(range(len(nodes)), min(2, len(nodes))):
        old = FUNCTIONS[nodes[k].function]
        alike = [f for f in FUNCTIONS.values() if (f.inputs, f.output) == (old.inputs, old.output)]
        new = random.choice(alike)
        nodes[k] = Node(new.name, nodes[k].inputs, (random.choice(new.values),) if new.values else ())
    return Program(tuple(nodes))


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


def test_there_are_28_different_answers() -> None:
    assert len(ANSWERS) == len(set(ANSWERS)) == 28
    assert {kind: len(answers) for kind, answers in KINDS.items()} == {
        "boolean": 2, "integer": 11, "shape": 3, "size": 2, "color": 8, "material": 2,
    }  # fmt: skip


def test_a_question_s_answer_is_of_the_kind_its_program_asks_for(asked) -> None:
    for _, questions in asked:
        for question in questions:
            assert kind_of(question.answer) == kind_asked(question.program)


def test_an_unknown_answer_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="did you mean 'purple'"):
        kind_of("purpel")
