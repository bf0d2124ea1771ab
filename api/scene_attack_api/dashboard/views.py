"""The data that the pages show of a job, taken from the record.

They are its trace, with and without a result, and the program of each question as a tree with what its functions attend
to.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scene_attack.analysis.verdict import judge
from scene_attack.runs.result import CHECKPOINT, Attended, QuestionResult, first_changed, most_changed
from scene_attack.runs.spec import group_words, question_names
from scene_attack_api.dashboard.charts import Chart, chart, upset
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import Facts, Value, execute
from scene_attack_questions.program import TYPE_WORDS, Node, Program, Type
from scene_attack_service.jobs.models import Artifact, Event, Job, State
from scene_attack_service.jobs.record import Record

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


def questions(result: Mapping[str, Any] | None, spec: Mapping[str, Any], names: Sequence[str]) -> list[Question]:
    """The questions of a result; none for a job that has no questions, or no result yet."""
    if result is None or not result.get("questions") or spec.get("record") is None:
        return []
    facts = Facts.of(SceneRecord.model_validate(spec["record"]))
    named = zip(result["questions"], names, strict=True)
    return [_question(number, question, name, facts) for number, (question, name) in enumerate(named)]


def objects(result: Mapping[str, Any] | None, spec: Mapping[str, Any]) -> list[SceneObject]:
    """The objects of a scene after CLEVR, with the values of an analysis by object if there is one."""
    if spec.get("record") is None:
        return []
    analysis = ((result or {}).get("analyses") or {}).get("coordinates")
    values = {} if analysis is None else dict(zip(analysis["parts"], analysis["log_odds"]["shapley"], strict=True))
    return [
        SceneObject(
            words=f"{thing['size']} {thing['color']} {thing['material']} {thing['shape']}",
            effects={
                group: values[f"object {number} {group}"]
                for group in spec["attack"]["groups"]
                if f"object {number} {group}" in values
            },
        )
        for number, thing in enumerate(spec["record"]["objects"])
    ]


def _question(number: int, stored: Mapping[str, Any], name: str, facts: Facts) -> Question:
    result = QuestionResult.model_validate(stored)
    program = Program.read(result.program)
    tree = _Tree(program, execute(program, facts), result.attention)
    root = tree.chain(len(program.nodes) - 1)
    steps = tree.steps
    return Question(
        number=number,
        name=name,
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


def all_events(record: Record, job_id: str) -> Iterator[Event]:
    """Every event of a job, in order."""
    after = 0
    while page := record.jobs.events(job_id, after):
        yield from page
        after = page[-1].number


def trace_of(job: Job, events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace of the result or, if there is none yet, that of the events, which are read for this alone."""
    if job.result:
        trace: list[dict[str, Any]] = job.result["trace"]
        return trace
    return trace_of_events(events)


def trace_of_events(events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace so far. A resumed attempt repeats some steps; its rows replace the earlier rows of these steps."""
    rows: list[dict[str, Any]] = []
    for event in events:
        if event.kind != "progress":
            continue
        for row in event.data["rows"]:
            while rows and rows[-1]["step"] >= row["step"]:
                rows.pop()
            rows.append(row)
    return rows


IMAGES = ("original.png", "attacked.png", "perturbation.png")
SEARCHED = ("coordinates", "coordinates that reach the answer")
"""Names in a plan for the coordinates of a group that the attack on a question searches."""
ROWS = 100
"""Rows of a trace that a page's table has at most."""
LEAST = 0.01
"""Least height of the axes of p (thousandths) and distance, so that rounding of an unchanged image is not magnified."""


def page(
    job: Job, events: Iterable[Event], artifacts: Sequence[Artifact], best: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Data that a job's page shows beside the job. The trace is the result's or, if there is none yet, that of the
    events; `best` is the best result of a job that ended before its time (scene_attack.runs.execute).
    """
    trace = trace_of(job, events)
    spec, result = job.spec, job.result
    asked = questions(result, spec, question_names(spec))
    shown = {name for question in asked for of in question.result.attention for name in (of.before, of.after)}
    things = objects(result, spec)
    rows = subsets(result)
    names = {group: group_words(spec, group) for group in (rows[-1]["groups"] if rows else ())}
    shares = None if result is None else result["attribution"]
    has_checkpoint = any(artifact.name == CHECKPOINT for artifact in artifacts)
    return {
        "subsets": rows,
        # Both are None without a result and for a single group; pages have other names of groups.
        "attribution": shares | {"parts": [names[part] for part in shares["parts"]]}
        if shares and len(names) > 1
        else None,
        "upset": shares and upset(rows, shares, names, [artifact.name for artifact in artifacts]),
        "last": trace[-1] if trace else None,
        "charts": {against: charts(trace, spec, against) for against in ("step", "queries", "seconds")},
        "rows": evenly(trace),
        "artifacts": [artifact for artifact in artifacts if artifact.name not in shown],
        "attention_files": [artifact for artifact in artifacts if artifact.name in shown],  # which are many
        "best": best,
        "continuable": has_checkpoint and job.state in (State.CANCELLED, State.FAILED),
        # Whether it began with the checkpoint of the job that it repeats, which it then has from its beginning. One
        # that only repeats has none with a result, and else its own later.
        "went_on": has_checkpoint
        and job.retry_of is not None
        and (result is not None or not trace or trace[0]["step"] > 0),
        "questions": asked,
        "objects": things,
        # The groups whose effect on single objects was measured.
        "effect_groups": [
            group for group in spec["attack"]["groups"] if any(group in thing.effects for thing in things)
        ],
        "limits": limits(result, spec) if asked else [],
        "image_size": tuple(spec["scene"]["camera"]["size"]),
    }


def limits(result: dict[str, Any] | None, spec: dict[str, Any]) -> list[dict[str, Any]]:
    """The plan's lines about the coordinates of the attacked groups."""
    items = [] if result is None else result["plan"]["items"]
    return [item for item in items if item["part"] in spec["attack"]["groups"] and item["what"] in SEARCHED]


def subsets(result: dict[str, Any] | None) -> list[dict[str, Any]]:
    """The table of subsets, each with its outcome as if its groups were all of the perturbation."""
    if result is None:
        return []
    truth, first = result["verdict"]["truth"], result["original"]["label"]
    return [
        subset | {"outcome": judge(truth, first, subset["label"], subset["fooled"])} for subset in result["subsets"]
    ]


def evenly(trace: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a trace at equal distances, and the last."""
    every = max(1, -(-len(trace) // ROWS))
    return [row for k, row in enumerate(trace) if k % every == 0 or k == len(trace) - 1]


def charts(trace: Sequence[dict[str, Any]], spec: dict[str, Any], against: str) -> list[Chart]:
    """The charts of a trace against "step", "queries" or "seconds"; an empty list for an empty trace."""
    if not trace:
        return []
    goal = spec["goal"]
    if goal.get("reach") is not None:
        loss, other = f"1 − probability of “{goal['reach']}”", "below 0: the network says the wanted label"
    else:
        loss, other = f"Probability of {_labels(goal.get('leave'))}", "below 0: another answer"

    def curve(key: str, scale: float = 1.0) -> list[tuple[float, float]]:
        return [(row[against], row[key] * scale) for row in trace]

    whole = against != "seconds"
    return [
        chart(loss, against, curve("loss"), include=(0, 1), whole=whole),
        chart("Log-probability advantage", against, curve("advantage"), threshold=0, note=other, whole=whole),
        chart(
            "Perceptibility p, in thousandths", against, curve("perceptibility", 1000), include=(0, LEAST), whole=whole
        ),
        chart("Distance ‖ΔY‖₂", against, curve("distance"), include=(0, LEAST), whole=whole),
    ]


def _labels(leave: str | int | list[str | int] | None) -> str:
    """The labels to leave, in words; the request of a job that has not begun may not name them."""
    if leave is None:
        return "the label to leave"
    return " or ".join(f"“{label}”" for label in (leave if isinstance(leave, list) else [leave]))
