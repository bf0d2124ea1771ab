"""The plan of a job that asks questions."""

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.runs.prepare import plan, prepare_exactly
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.targets import registry
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from tests.unit.jobs.small import LIBRARY, SPHERE
from tests.unit.questions.iep.seeded import COUNT, INFO, TAUGHT, favouring, program, target

pytestmark = pytest.mark.slow

RECORD = generate(8, 2, objects=(4, 4))
SCENE = describe(RECORD, (60, 80)).model_copy(update={"shadows": None})
WORDS = next(words for words, known in TAUGHT.items() if known == COUNT)


def asking(*questions: object) -> JobSpec:
    source = {"format": "clevr", "record": RECORD.model_dump(mode="json")}
    where = {"scene": SCENE.model_dump(mode="json") | {"source": source}}
    asked = {"name": INFO.name, "ask": {"questions": questions}}
    return parse(where | {"target": asked, "attack": {"renderer": "pyrender", "method": "zoo"}})


def asking_one(question: object) -> JobSpec:
    target_of = {"name": INFO.name, "ask": {"question": question}}
    return parse(asking().model_dump(mode="json") | {"target": target_of})


def test_it_has_the_questions_and_what_the_search_leaves_out() -> None:
    with registry.registered(INFO, target()):
        with pytest.raises(InvalidRequest, match="gets it wrong before the attack"):
            plan(asking(COUNT.written(), WORDS), LIBRARY)
        scores = prepare_exactly(asking_one(COUNT.written()), LIBRARY).original.logits
    with registry.registered(INFO, favouring("4", scores[None])):
        found = plan(asking(COUNT.written(), WORDS), LIBRARY)
        with pytest.raises(InvalidRequest, match="there are 4"):
            plan(asking(program("scene", "unique 0", "query_size 1").written()), LIBRARY)
    assert [(one.question, one.program, one.kind, one.right) for one in found.tasks["questions"].questions] == [
        (words, COUNT.written(), "integer", "4") for words in (None, WORDS)
    ]
    listed = {item.part: (item.kept, item.of) for item in found.items if item.what == "coordinates" and item.part}
    assert listed == {"illumination": (12, 13), "color": (12, 12), "translation": (8, 12), "rotation": (4, 12)}


def test_without_a_question_it_is_the_renderer_s() -> None:
    assert "tasks" not in plan(parse({"scene": SPHERE}), LIBRARY).model_dump(mode="json")
