"""Programs: their form in files, and why one is invalid."""

from services.questions.functions import FUNCTIONS
from services.questions.program import Node, Program

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


def test_an_output_may_be_used_twice() -> None:
    nodes = (Node("scene", (), ()), Node("union", (0, 0), ()), Node("count", (1,), ()))
    assert Program(nodes).types[-1] == "integer"
