"""No generated question is ill-posed or degenerate, judged on its program alone; and every family is found."""

from collections.abc import Iterator
from random import Random

import pytest

from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.executor import Facts, execute
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.generator import QuestionRecord, build, instances
from scene_attack_questions.program import Program

pytestmark = pytest.mark.slow


def executed(asked) -> Iterator[tuple[QuestionRecord, Program, tuple, Facts]]:
    for scene, questions in asked:
        facts = Facts.of(scene)
        for question in questions:
            yield question, question.program, execute(question.program, facts), facts


def user(program: Program, k: int) -> int:
    """The node that takes node k's output."""
    return next(j for j, node in enumerate(program.nodes) if k in node.inputs)


def filtered(program: Program, k: int, members: frozenset[int], facts: Facts) -> frozenset[int]:
    """What the filters that follow node k leave of a set."""
    following = program.nodes[user(program, k)]
    if not following.function.startswith("filter_"):
        return members
    members = members & facts.having[following.function.removeprefix("filter_"), following.values[0]]
    return filtered(program, user(program, k), members, facts)


def before(program: Program, k: int) -> Iterator[int]:
    """The nodes that node k's output comes from."""
    for source in program.nodes[k].inputs:
        yield source
        yield from before(program, source)


def test_every_filter_leaves_something_out(asked) -> None:
    for question, program, outputs, _ in executed(asked):
        for k, node in enumerate(program.nodes):
            if node.function.startswith("filter_"):
                assert outputs[k] < outputs[node.inputs[0]], question.question


def test_every_relation_and_shared_attribute_changes_its_phrase(asked) -> None:
    seen = set()
    for question, program, outputs, facts in executed(asked):
        for k, node in enumerate(program.nodes):
            name = node.function
            inside = program.nodes[user(program, k)].function if k + 1 < len(outputs) else ""
            if name in ("relate", "intersect", "union") or name.startswith("same_"):
                seen.add(name)
                whole = filtered(program, k, outputs[k], facts)
                if inside != "intersect":
                    assert whole != filtered(program, k, facts.everything, facts), question.question
                if name in ("intersect", "union"):
                    for side in node.inputs:
                        assert whole != filtered(program, k, outputs[side], facts), question.question
    assert len(seen) == 7


def test_no_chain_comes_back_to_an_object(asked) -> None:
    for question, program, outputs, _ in executed(asked):
        for k, node in enumerate(program.nodes):
            if node.function == "unique":
                assert outputs[k] not in [
                    outputs[j] for j in before(program, k) if program.nodes[j].function == "unique"
                ], question.question


def test_no_query_names_what_it_asks(asked) -> None:
    for question, program, _, _ in executed(asked):
        for node in program.nodes:
            name, _, attribute = node.function.partition("_")
            if name in ("query", "same"):
                # From the object back to where its phrase begins.
                (k,) = program.nodes[node.inputs[0]].inputs
                while program.nodes[k].function.startswith("filter_"):
                    assert program.nodes[k].function != f"filter_{attribute}", question.question
                    (k,) = program.nodes[k].inputs
                assert program.nodes[k].function != f"same_{attribute}", question.question


def test_compared_objects_and_sets_differ(asked) -> None:
    for question, program, outputs, _ in executed(asked):
        root = program.nodes[-1]
        if len(root.inputs) == 2:
            first, second = (outputs[program.nodes[k].inputs[0]] for k in root.inputs)
            assert first != second, question.question


def test_no_comparison_of_numbers_follows_from_its_words(asked) -> None:
    for question, program, _, _ in executed(asked):
        if program.nodes[-1].function in ("equal_integer", "less_than", "greater_than"):
            (wide, of_wide), (narrow, of_narrow) = (words(program, k) for k in program.nodes[-1].inputs)
            for one, other, said, more in ((wide, narrow, of_wide, of_narrow), (narrow, wide, of_narrow, of_wide)):
                assert not (said <= more and one in (["scene"], other)), question.question


def words(program: Program, count: int) -> tuple[list[str], set[str]]:
    """Where the counted objects come from, as the functions up to there, and the values that they are counted by."""
    (k,), said = program.nodes[count].inputs, set()
    while program.nodes[k].function.startswith("filter_"):
        said.add(program.nodes[k].label)
        (k,) = program.nodes[k].inputs
    return [program.nodes[j].label for j in (k, *before(program, k))], said


@pytest.mark.parametrize("index", range(90))
def test_every_family_is_found_in_some_scene_with_its_program(index: int) -> None:
    family, random = FAMILIES[index], Random(index)
    for k in range(20):
        facts = Facts.of(generate(12, k, objects=(6, 9)))
        phrases = next(instances(family, facts, random), None)
        if phrases is not None:
            program = build(family, phrases)
            execute(program, facts)
            assert program.nodes[-1].function == family.asks
            relations = sum(node.function == "relate" for node in program.nodes)
            expected = {"zero_hop": 0, "one_hop": 1, "two_hop": 2, "three_hop": 3, "single_and": 2, "same_relate": 0}
            assert relations == expected.get(family.kind, relations)
            return
    raise AssertionError(f"no instance of family {index}")
