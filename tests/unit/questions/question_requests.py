"""Requests with questions about a small scene after CLEVR."""

from typing import Any

from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from tests.unit.questions.iep.seeded import INFO, program

RECORD = generate(8, 2, objects=(4, 4))
SCENE = describe(RECORD, (60, 80)).model_copy(update={"shadows": None})
"""Small and without shadows, so that it is drawn at once."""
SOURCE = {"format": "clevr", "record": RECORD.model_dump(mode="json")}
WHERE = {"scene": SCENE.model_dump(mode="json") | {"source": SOURCE}}
ATTACK = {"renderer": "image", "base_renderer": "pyrender", "method": "fgsm", "steps": 2}


def asking(question: Any, leave_kind: bool = False, **changes: Any) -> dict[str, Any]:
    """The request of a question."""
    ask = {"question": question, "leave_kind": leave_kind}
    return WHERE | {"target": {"name": INFO.name, "ask": ask}, "attack": ATTACK} | changes


def calls(*lines: str) -> list[dict[str, Any]]:
    return program(*lines).written()


def several(*questions: Any, question: Any = None, **changes: Any) -> dict[str, Any]:
    """The request of several questions together."""
    return asking(None, **changes) | {
        "target": {"name": INFO.name, "ask": {"question": question, "questions": questions}}
    }
