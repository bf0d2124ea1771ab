"""Requests with questions that are refused before anything is queued."""

from collections.abc import Iterator
from typing import Any

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.runs.prepare import plan, prepare
from scene_attack.runs.spec import parse
from scene_attack.targets import registry
from tests.unit.jobs.small import LIBRARY, SPHERE
from tests.unit.questions.iep.seeded import INFO, target
from tests.unit.questions.question_requests import RECORD, SOURCE, WHERE, asking, calls, several


@pytest.fixture(autouse=True)
def _seeded() -> Iterator[None]:
    with registry.registered(INFO, target()):
        yield


ABSENT = next(
    f"filter_color 0 {color}"
    for color in ("red", "blue", "green", "gray", "cyan")
    if color not in {one.color for one in RECORD.objects}
)

HUGE = RECORD.model_dump(mode="json")
HUGE["objects"][0]["size"] = "huge"

FLOATING = RECORD.model_dump(mode="json")
FLOATING["objects"][0]["coords_3d"][2] += 0.5


def of(record: dict[str, Any]) -> dict[str, Any]:
    return {"source": {"format": "clevr", "record": record}}


def made(**generate: Any) -> dict[str, Any]:
    return {"source": {"format": "clevr", "generate": generate}}


REFUSED: list[tuple[str, str, dict[str, Any]]] = [
    ("target.ask.question", "'mauve', is not known", asking("How many mauve things are there?")),
    ("target.ask.question", "needs 1 to 128", asking("?!")),
    ("target.ask.question", "is required", WHERE | {"target": {"name": INFO.name}}),
    ("target.ask.question.1", "takes 1 input", asking([{"function": "scene"}, {"function": "count"}])),
    (
        "target.ask.question.1",
        "no function 'cuont'",
        asking([{"function": "scene"}, {"function": "cuont", "inputs": [0]}]),
    ),
    ("target.ask.question.2", "must be an object", asking(calls("scene", "filter_size 0 large", "query_color 1"))),
    (
        "target.ask.question.1.inputs.0",
        "an integer",
        asking([{"function": "scene"}, {"function": "count", "inputs": ["0"]}]),
    ),
    ("target.ask.question", "it needs 1 to 64", asking([])),
    ("target.ask.question.2", "there is none", asking(calls("scene", ABSENT, "unique 1", "query_size 2"))),
    ("target.ask.question.1", "there are 4", asking(calls("scene", "unique 0", "query_size 1"))),
    ("target.ask.question", "asks something else", asking("What is left of the cube?")),
    ("scene.source.record.objects.0", "floats above", asking(calls("scene", "count 0"), scene=of(FLOATING))),
    ("scene.source", "is required", asking(calls("scene", "count 0"), scene=SPHERE)),
    ("scene", "are not those of its source", asking(calls("scene", "count 0"), scene=SPHERE | {"source": SOURCE})),
    ("scene", "are not those of its source", {"scene": SPHERE | {"source": SOURCE}}),
    ("scene.source.record.objects.0", "floats above", {"scene": SPHERE | of(FLOATING)}),
    ("goal.reach", "has no label 'mauve'", asking(calls("scene", "count 0"), goal={"reach": "mauve"})),
    ("goal.truth", "the right answer is '4'", asking(calls("scene", "count 0"), goal={"truth": "3"})),
    ("target.ask", "is asked nothing", {"scene": SPHERE, "target": {"ask": {"leave_kind": True}}}),
    ("target.ask.question", "is required", WHERE | {"target": {"name": INFO.name, "ask": {"leave_kind": True}}}),
    ("goal.leave", "of the kind integer", asking(calls("scene", "count 0"), leave_kind=True, goal={"leave": "4"})),
    ("goal.reach", "is a label to leave", asking(calls("scene", "count 0"), leave_kind=True, goal={"reach": "3"})),
    ("target.ask.questions.1.1", "no function 'cuont'", several(calls("scene", "count 0"), calls("scene", "cuont 0"))),
    ("target.ask.questions.1", "needs 1 to 64", several(calls("scene", "count 0"), [])),
    ("target.ask.questions.1", "'mauve', is not known", several(calls("scene", "count 0"), "Is it mauve?")),
    ("target.ask.questions.0.1", "there are 4", several(calls("scene", "unique 0", "query_size 1"))),
    (
        "target.ask.questions",
        "either `question` or `questions`",
        several(calls("scene", "count 0"), question="Is it red?"),
    ),
    ("goal.reach", "have answers of their own", several(calls("scene", "count 0"), goal={"reach": "3"})),
    ("target.ask.questions.0", "gets it wrong before", several(calls("scene", "count 0"))),
    ("analysis.adaptive", "there are several", several(calls("scene", "count 0"), analysis={"adaptive": {}})),
    ("scene", "are not those of its source", {"scene": SPHERE | made(seed=1)}),
    ("scene.source.generate", "leave it out where `record`", {"scene": {"source": SOURCE | {"generate": {}}}}),
    ("scene.source.record", "is required", {"scene": {"source": {"format": "clevr"}}}),
    ("scene.source.format", "there is no 'clever'", {"scene": {"source": {"format": "clever"}}}),
    ("scene.source.format", "there are clevr", {"scene": {"source": {}}}),
    ("scene.source", "with a `format`", {"scene": {"source": "clevr"}}),
    ("scene.source.generate.objects", "from 1 to 10", {"scene": made(objects=11)}),
    ("scene.source.record.objects.0.size", "must be", {"scene": of(HUGE)}),
    ("scene", "is missing", {"target": {"name": INFO.name}}),
]


@pytest.mark.parametrize(("field", "words", "data"), REFUSED, ids=[f"{a}-{b}" for a, b, _ in REFUSED])
def test_refused_before_anything_is_queued(field: str, words: str, data: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest) as refused:
        prepare(parse(data), LIBRARY)
    assert words in str(refused.value)
    assert refused.value.field == field


def test_a_scene_beside_its_record_is_compared_before_planning() -> None:
    with pytest.raises(InvalidRequest, match="are not those of its source"):
        plan(parse({"scene": SPHERE | {"source": SOURCE}}), LIBRARY)
