"""Small random worlds: objects on a floor with true attributes and positions, questions about them, and features.

Nothing here is shared with the code that is tested: programs are run by a recursion over sets of objects. Features are
what a perfect trunk could give: attributes and the place inside the cell, at the cells of objects, in a random basis.
"""

from dataclasses import dataclass
from itertools import count
from random import Random

import torch
from torch import Tensor

from scene_attack_questions.program import Node, Program

SHAPES, SIZES = ("cube", "sphere", "cylinder"), ("small", "large")
COLORS = ("gray", "red", "blue", "green", "brown", "purple", "cyan", "yellow")
MATERIALS = ("rubber", "metal")
ATTRIBUTES = {"shape": SHAPES, "size": SIZES, "color": COLORS, "material": MATERIALS}
WORDS = (*SHAPES, *SIZES, *COLORS, *MATERIALS)
MARGIN = 0.4
"""Least distance between two objects along each direction, so that left and right are decided."""
Result = tuple[int, ...] | int | str | bool


@dataclass(frozen=True)
class Thing:
    """An object: its attributes, and its place on the floor to the right of and behind the middle, within ±3."""

    attributes: dict[str, str]
    right: float
    behind: float

    @property
    def pixel(self) -> tuple[float, float]:
        """Row and column of its centre in an image of 240×320."""
        nearness = 11.3 / (11.3 + 0.88 * self.behind)
        return 120 - 31 * 0.47 * self.behind * nearness, 160 + 31 * self.right * nearness

    @property
    def cell(self) -> int:
        """The feature cell of its centre."""
        row, column = self.pixel
        return int(row // 16) * 20 + int(column // 16)


def scene(random: Random, least: int = 3, most: int = 6) -> tuple[Thing, ...]:
    """A random scene."""
    things: list[Thing] = []
    wanted = random.randint(least, most)
    while len(things) < wanted:
        looks = {name: random.choice(values) for name, values in ATTRIBUTES.items()}
        new = Thing(looks, random.uniform(-3, 3), random.uniform(-3, 3))
        near = (min(abs(new.right - one.right), abs(new.behind - one.behind)) < MARGIN for one in things)
        if not any(near) and new.cell not in [one.cell for one in things]:
            things.append(new)
    return tuple(things)


def features(things: tuple[Thing, ...], noise: float = 0.1, seed: int = 0) -> Tensor:
    """Features [96, 15, 20] of a scene; `seed` of the noise."""
    basis = torch.randn(18, 96, generator=torch.Generator().manual_seed(7)) / 3
    made = noise * torch.randn(300, 96, generator=torch.Generator().manual_seed(seed))
    for thing in things:
        row, column = thing.pixel
        values = [float(word in thing.attributes.values()) for word in WORDS]
        own = torch.tensor([*values, 1.0, row % 16 / 16 - 0.5, column % 16 / 16 - 0.5])
        made[thing.cell] += own @ basis
    return made.T.reshape(96, 15, 20)


def run(things: tuple[Thing, ...], program: Program) -> list[Result] | None:
    """The results of all nodes, by recursion; None if `unique` has none or many."""
    try:
        return [_result(things, program, place) for place in range(len(program.nodes))]
    except LookupError:
        return None


def _result(things: tuple[Thing, ...], program: Program, place: int) -> Result:
    node = program.nodes[place]
    taken = [_result(things, program, one) for one in node.inputs]
    name, _, what = node.function.partition("_")
    everything = range(len(things))
    if name == "scene":
        return tuple(everything)
    if name == "filter":
        return tuple(i for i in taken[0] if things[i].attributes[what] == node.values[0])
    if name == "unique":
        (one,) = taken[0] if len(taken[0]) == 1 else ([][0],)
        return (one,)
    if name == "relate":
        return tuple(i for i in everything if _is_there(things[i], things[taken[0][0]], node.values[0]))
    if name == "same":
        me = taken[0][0]
        return tuple(i for i in everything if i != me and things[i].attributes[what] == things[me].attributes[what])
    if name == "union":
        return tuple(sorted({*taken[0], *taken[1]}))
    if name == "intersect":
        return tuple(sorted({*taken[0]} & {*taken[1]}))
    if name == "count":
        return len(taken[0])
    if name == "exist":
        return len(taken[0]) > 0
    if name == "query":
        return things[taken[0][0]].attributes[what]
    return {"equal": taken[0] == taken[1], "less": taken[0] < taken[1], "greater": taken[0] > taken[1]}[name]


def _is_there(one: Thing, other: Thing, direction: str) -> bool:
    return {
        "left": one.right < other.right,
        "right": one.right > other.right,
        "front": one.behind < other.behind,
        "behind": one.behind > other.behind,
    }[direction]


def word(result: Result) -> str:
    """The answer that a result that is no set is."""
    return {True: "yes", False: "no"}[result] if isinstance(result, bool) else str(result)


FAMILIES = ("exist", "count", "query", "relate", "same", "integer", "equal", "logic")


def question(random: Random, things: tuple[Thing, ...], family: str) -> tuple[Program, list[Result]]:
    """A random well-posed question of a family, and the results of its nodes; yes and no are about equally likely."""
    wanted = random.random() < 0.5
    for attempt in count():
        nodes: list[Node] = []
        _ask(random, nodes, family)
        program = Program(tuple(nodes))
        results = run(things, program)
        if results is not None and (results[-1] is not (not wanted) or attempt > 100):
            return program, results
    raise AssertionError


def _ask(random: Random, nodes: list[Node], family: str) -> None:
    def add(function: str, *inputs: int, value: str = "") -> int:
        nodes.append(Node(function, inputs, (value,) if value else ()))
        return len(nodes) - 1

    def filtered(start: int, least: int = 0) -> int:
        for name in random.sample(sorted(ATTRIBUTES), random.randint(least, 3)):
            start = add(f"filter_{name}", start, value=random.choice(ATTRIBUTES[name]))
        return start

    def thing() -> int:
        return add("unique", filtered(add("scene"), 1))

    def last(of: int) -> None:
        kind = random.choice(["count", "exist", "query"])
        if kind == "query":
            add(f"query_{random.choice(sorted(ATTRIBUTES))}", add("unique", of))
        else:
            add(kind, of)

    if family in ("exist", "count"):
        add(family, filtered(add("scene"), 1))
    elif family == "query":
        add(f"query_{random.choice(sorted(ATTRIBUTES))}", thing())
    elif family == "relate":
        place = thing()
        for hop in range(random.randint(1, 2)):
            place = add("unique", place) if hop else place
            place = filtered(add("relate", place, value=random.choice(["left", "right", "front", "behind"])))
        last(place)
    elif family == "same":
        last(filtered(add(f"same_{random.choice(sorted(ATTRIBUTES))}", thing())))
    elif family == "integer":
        one, other = (add("count", filtered(add("scene"), 1)) for _ in range(2))
        add(random.choice(["equal_integer", "less_than", "greater_than"]), one, other)
    elif family == "equal":
        name = random.choice(sorted(ATTRIBUTES))
        one, other = (add(f"query_{name}", thing()) for _ in range(2))
        add(f"equal_{name}", one, other)
    else:
        one, other = (filtered(add("relate", thing(), value=random.choice(["left", "behind"]))) for _ in range(2))
        add(random.choice(["count", "exist"]), add(random.choice(["union", "intersect"]), one, other))
