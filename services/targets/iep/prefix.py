"""Programs in prefix order: a sequence of functions with their values, the root first, each before its inputs.

As every function has a fixed number of inputs, the sequence has no need of brackets, and its end is known.
"""

from collections.abc import Sequence

from services.questions.functions import FUNCTIONS
from services.questions.program import MAX_NODES, InvalidProgram, Node, Program

TOKENS = tuple(
    f"{name}[{value}]" if value else name for name, function in FUNCTIONS.items() for value in function.values or ("",)
)
"""The functions with their values."""
ARITIES = tuple(len(FUNCTIONS[token.partition("[")[0]].inputs) for token in TOKENS)
"""The number of inputs of each."""


def to_prefix(program: Program) -> list[str]:
    """Returns a valid program's functions in prefix order. A node that several take is written once for each."""

    def written(place: int) -> list[str]:
        node = program.nodes[place]
        return [node.label, *(token for one in node.inputs for token in written(one))]

    return written(len(program.nodes) - 1)


def from_prefix(tokens: Sequence[str]) -> Program:
    """Returns the program of functions in prefix order.

    Raises InvalidProgram for an unknown function, for a sequence that ends early or goes on after the end, and for a
    program whose types do not fit.
    """
    if len(tokens) > MAX_NODES:
        raise InvalidProgram(None, "form", f"it has {len(tokens)} functions; at most {MAX_NODES} are allowed")
    nodes: list[Node] = []
    rest = list(reversed(tokens))

    def parse() -> int:
        if not rest:
            raise InvalidProgram(None, "form", f"it ends early, after {len(tokens)} functions")
        token = rest.pop()
        if token not in TOKENS:
            raise InvalidProgram(None, "function", f"there is no function {token!r}")
        function, _, value = token.removesuffix("]").partition("[")
        inputs = tuple(parse() for _ in FUNCTIONS[function].inputs)
        nodes.append(Node(function, inputs, (value,) if value else ()))
        return len(nodes) - 1

    parse()
    if rest:
        raise InvalidProgram(None, "form", f"it goes on after its end, with {rest[-1]!r}")
    program = Program(tuple(nodes))
    program.check()
    return program
