"""Programs: their form in files, and why one is invalid."""

import pickle

import pytest

from scene_attack_questions.program import FUNCTIONS, MAX_NODES, InvalidProgram, Node, Program

SCENE = {"function": "scene", "inputs": [], "value_inputs": []}
RED = {"function": "filter_color", "inputs": [0], "value_inputs": ["red"]}
UNIQUE = {"function": "unique", "inputs": [1], "value_inputs": []}
COUNT = {"function": "count", "inputs": [1], "value_inputs": []}


def call(function: str, inputs: list[int], *values: str) -> dict:
    return {"function": function, "inputs": inputs, "value_inputs": list(values)}


def test_the_catalogue_has_the_functions_of_clevr() -> None:
    four = ("size", "color", "material", "shape")
    names = {"scene", "unique", "relate", "union", "intersect", "count", "exist", "equal_integer", "less_than"}
    names |= {"greater_than"} | {f"{kind}_{one}" for kind in ("filter", "query", "same", "equal") for one in four}
    assert set(FUNCTIONS) == names
    assert FUNCTIONS["relate"].values == ("left", "right", "front", "behind")


def test_both_forms_are_read_and_the_published_one_is_written() -> None:
    published = [SCENE, RED, COUNT]
    generators = [
        {"type": "scene", "inputs": []},
        {"type": "filter_color", "inputs": [0], "side_inputs": ["red"]},
        {"type": "count", "inputs": [1]},
    ]
    program = Program.read(published)
    assert Program.read(generators) == program
    assert program.written() == published
    assert program.types == ("set", "set", "integer")
    assert [node.label for node in program.nodes] == ["scene", "filter_color[red]", "count"]


@pytest.mark.parametrize(
    ("written", "node", "reason", "said"),
    [
        ([], None, "form", "0 nodes"),
        ([SCENE] * (MAX_NODES + 1), None, "form", "65 nodes"),
        ("scene", None, "form", "list"),
        ([SCENE, "count"], 1, "form", "object"),
        ([SCENE, {"function": 3}], 1, "form", "name"),
        ([SCENE, {"function": "count", "inputs": ["0"]}], 1, "form", "indices"),
        ([SCENE, {"function": "count", "inputs": [True]}], 1, "form", "indices"),
        ([SCENE, {"function": "count", "inputs": [0], "value_inputs": "red"}], 1, "form", "words"),
        ([SCENE, call("cuont", [0])], 1, "function", "did you mean 'count'"),
        ([SCENE, call("count", [])], 1, "arity", "1 input, and has 0"),
        ([SCENE, call("union", [0])], 1, "arity", "2 inputs, and has 1"),
        ([SCENE, call("filter_color", [0]), COUNT], 1, "arity", "1 value, and has 0"),
        ([SCENE, RED, call("count", [1], "red")], 2, "arity", "no value, and has 1"),
        ([SCENE, call("filter_color", [0], "pink"), COUNT], 1, "value", "'pink'"),
        ([SCENE, call("filter_color", [0], "cube"), COUNT], 1, "value", "'cube'"),
        ([SCENE, RED, UNIQUE, call("relate", [2], "above"), call("count", [3])], 3, "value", "'above'"),
        ([SCENE, RED, UNIQUE, call("count", [2])], 3, "type", "is an object, that of node 2; it must be a set"),
        ([SCENE, RED, call("query_size", [1])], 2, "type", "must be an object"),
        ([SCENE, RED, UNIQUE, call("query_size", [2]), call("query_color", [2]), call("equal_size", [3, 4])], 5, "type",
         "input 2 of equal_size is a color"),
        ([SCENE, call("count", [1])], 1, "order", "no earlier node"),
        ([SCENE, call("count", [-1])], 1, "order", "no earlier node"),
        ([SCENE, RED, call("count", [0])], 1, "unused", "filter_color[red]"),
        ([SCENE, RED], 1, "root", "set of objects"),
        ([SCENE, RED, UNIQUE], 2, "root", "an object"),
    ],
)  # fmt: skip
def test_an_invalid_program_is_refused_with_its_node_and_why(written, node, reason: str, said: str) -> None:
    with pytest.raises(InvalidProgram) as caught:
        Program.read(written).check()
    assert (caught.value.node, caught.value.reason) == (node, reason)
    assert said in caught.value.detail
    assert caught.value.field == ("program" if node is None else f"program.{node}")
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.node, again.reason, again.detail) == (node, reason, caught.value.detail)


def test_generated_programs_are_valid_and_written_as_they_are_read(asked) -> None:
    for _, questions in asked[:100]:
        for question in questions:
            question.program.check()
            assert Program.read(question.program.written()) == question.program


def test_an_output_may_be_used_twice() -> None:
    nodes = (Node("scene", (), ()), Node("union", (0, 0), ()), Node("count", (1,), ()))
    assert Program(nodes).types[-1] == "integer"
