"""What the page of a job shows of its questions: the program of each as a tree, with what its functions attend to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from scene_attack_questions.ask import program_name
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import Facts, Value, execute
from scene_attack_questions.program import TYPE_WORDS, Node, Program, Type
from scene_attack_questions.records import CHANGED, Attended, QuestionResult, first_changed, most_changed

SEARCHED = ("coordinates", "coordinates that reach the answer")
"""Names in a plan for the coordinates of a group that the attack on a question searches."""
_WORDS = {
    "scene": "all objects",
    "unique": "the only one",
    "union": "those in either set",
    "intersect": "those in both sets",
    "count": "how many?",
    "exist": "is there one?",
    "equal_integer": "as many?",
    "less_than": "fewer in the first?",
    "greater_than": "more in the first?",
}
_RELATIONS = {"left": "left of it", "right": "right of it", "front": "in front of it", "behind": "behind it"}


@dataclass(frozen=True)
class Step:
    """A function of a program.

    words: what it does, "those that are red"; label: its name, "filter_color[red]"; gives: the type of its output in
    words; right: its output by the scene's record, in words. shown_before: it is a step of an earlier chain too, and is
    shown in whole there.
    """

    number: int
    words: str
    label: str
    gives: str
    right: str
    attention: Attended | None
    is_first: bool
    is_most: bool
    is_answer: bool
    shown_before: bool


@dataclass(frozen=True)
class Chain:
    """Functions each of which takes the output of the one before it. The first takes those of `inputs`, if any."""

    inputs: tuple["Chain", ...]
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Question:
    """A question and its answers, with its program as a tree.

    scale: the end of the scale of changes of attention, at least 1, one object. first and most: the steps whose
    attention changed first, to another object, and most.
    """

    number: int
    name: str
    result: QuestionResult
    asks_for: str
    program: Chain
    scale: float
    first: Step | None
    most: Step | None


@dataclass(frozen=True)
class SceneObject:
    """An object of a scene after CLEVR: "small red rubber cube", and the Shapley values of its groups, log-odds."""

    words: str
    effects: dict[str, float]


@dataclass(frozen=True)
class Page:
    """What the template is given. groups: those whose effect on single objects was measured. limits: lines of the plan
    about the coordinates of the attacked groups."""

    questions: tuple[Question, ...]
    objects: tuple[SceneObject, ...]
    groups: tuple[str, ...]
    limits: tuple[Mapping[str, Any], ...]
    size: tuple[int, int]
    changed: float = CHANGED

    @classmethod
    def of(cls, questions: Sequence[QuestionResult], spec: Mapping[str, Any], result: Mapping[str, Any]) -> Self:
        """The page of a result, from the request and the result as JSON data."""
        record = SceneRecord.model_validate(spec["scene"]["source"]["record"])
        facts, things = Facts.of(record), _objects(record, spec, result)
        groups = spec["attack"]["groups"]
        rows, columns = spec["scene"]["camera"]["size"]
        return cls(
            questions=tuple(_question(number, question, facts) for number, question in enumerate(questions)),
            objects=things,
            groups=tuple(group for group in groups if any(group in thing.effects for thing in things)),
            limits=tuple(
                item for item in result["plan"]["items"] if item["part"] in groups and item["what"] in SEARCHED
            ),
            size=(rows, columns),
        )


def _objects(record: SceneRecord, spec: Mapping[str, Any], result: Mapping[str, Any]) -> tuple[SceneObject, ...]:
    """The objects of the scene, with the values of an analysis by object if there is one."""
    analysis = (result.get("analyses") or {}).get("coordinates")
    values = {} if analysis is None else dict(zip(analysis["parts"], analysis["log_odds"]["shapley"], strict=True))
    return tuple(
        SceneObject(
            words=f"{thing.size} {thing.color} {thing.material} {thing.shape}",
            effects={
                group: values[f"object {number} {group}"]
                for group in spec["attack"]["groups"]
                if f"object {number} {group}" in values
            },
        )
        for number, thing in enumerate(record.objects)
    )


def _question(number: int, result: QuestionResult, facts: Facts) -> Question:
    program = Program.read(result.program)
    tree = _Tree(program, execute(program, facts), result.attention)
    root = tree.chain(len(program.nodes) - 1)
    steps = tree.steps
    return Question(
        number=number,
        name=result.question or program_name([node.function for node in program.nodes]),
        result=result,
        asks_for=TYPE_WORDS[program.types[-1]],
        program=root,
        scale=max([1.0, *(attention.change for attention in result.attention)]),
        first=next((step for step in steps.values() if step.is_first), None),
        most=next((step for step in steps.values() if step.is_most), None),
    )


class _Tree:
    """Makes the chains of a program; `steps` are those made so far, by number."""

    def __init__(self, program: Program, outputs: Sequence[Value], attention: Sequence[Attended]) -> None:
        self._program, self._outputs = program, outputs
        self._attention = {change.node: change for change in attention}
        self._first, self._most = first_changed(attention), most_changed(attention)
        self.steps: dict[int, Step] = {}

    def chain(self, last: int) -> Chain:
        """The chain that ends in a node. A node that several take is shown in whole in the first of their chains."""
        numbers = [last]
        inputs = self._program.nodes[last].inputs
        while len(inputs) == 1 and numbers[-1] not in self.steps:
            numbers.append(inputs[0])
            inputs = self._program.nodes[inputs[0]].inputs
        again = numbers[-1] in self.steps
        before = () if again else tuple(self.chain(source) for source in inputs)
        return Chain(before, tuple(self._step(number) for number in reversed(numbers)))

    def _step(self, number: int) -> Step:
        node, gives = self._program.nodes[number], self._program.types[number]
        attention = self._attention.get(number)
        step = Step(
            number=number,
            words=_words(node),
            label=node.label,
            gives=TYPE_WORDS[gives],
            right=_output(self._outputs[number], gives),
            attention=attention,
            is_first=attention is not None and attention == self._first,
            is_most=attention is not None and attention == self._most,
            is_answer=number == len(self._program.nodes) - 1,
            shown_before=number in self.steps,
        )
        return self.steps.setdefault(number, step) if not step.shown_before else step


def _words(node: Node) -> str:
    name, _, attribute = node.function.partition("_")
    if node.function in _WORDS:
        return _WORDS[node.function]
    if name == "filter":
        return f"those that are {node.values[0]}{'s' if attribute == 'shape' else ''}"
    if name == "relate":
        return f"those {_RELATIONS[node.values[0]]}"
    return {"query": f"its {attribute}", "same": f"others of its {attribute}", "equal": f"the same {attribute}?"}[name]


def _output(value: Value, kind: Type) -> str:
    if isinstance(value, frozenset):
        return ", ".join(map(str, sorted(value))) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"object {value}" if kind == "object" else str(value)
