"""The examples that ask questions, without the network: their questions are of the language and have answers."""

import json
from pathlib import Path

import pytest

from scene_attack.runs.spec import JobSpec, parse
from scene_attack_questions.ask import Questions
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import Facts, answer
from scene_attack_questions.program import Node, Program
from scene_attack_questions.source import Clevr
from scene_attack_questions.text import encoded
from scene_attack_worker.commands.demo import QUESTION

EXAMPLES = Path(__file__).parents[3] / "examples"
PROGRAMS = {
    "What is the color of the object that is left of the cyan thing?": (
        "red",
        ("filter_color 0 cyan", "unique 1", "relate 2 left", "unique 3", "query_color 4"),
    ),
    "The brown object has what shape?": ("cylinder", ("filter_color 0 brown", "unique 1", "query_shape 2")),
    "There is a cube; what is it made of?": ("rubber", ("filter_shape 0 cube", "unique 1", "query_material 2")),
    "The object right of the blue thing is what color?": (
        "cyan",
        ("filter_color 0 blue", "unique 1", "relate 2 right", "unique 3", "query_color 4"),
    ),
    "The yellow object is what shape?": ("sphere", ("filter_color 0 yellow", "unique 1", "query_shape 2")),
    "How many matte things are there?": ("3", ("filter_material 0 rubber", "count 1")),
}
"""What each question means: its right answer, and after `scene` the functions with the one they take and the value."""


def right(record: SceneRecord, calls: tuple[str, ...]) -> str:
    nodes = [Node("scene", (), ())]
    for call in calls:
        name, taken, *values = call.split()
        nodes.append(Node(name, (int(taken),), tuple(values)))
    return answer(Program(tuple(nodes)), Facts.of(record))


def asked(spec: JobSpec) -> Questions:
    assert isinstance(spec.target.ask, Questions)
    return spec.target.ask


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("vqa-*.json")), ids=lambda path: path.stem)
def test_an_example_asks_what_its_scene_answers(path: Path) -> None:
    spec = parse(json.loads(path.read_text()))
    assert spec.target.name == "iep"
    questions = asked(spec).asked
    assert questions
    assert isinstance(spec.scene.source, Clevr)
    for question in questions:
        assert isinstance(question, str)
        assert encoded(question)
        known, calls = PROGRAMS[question]
        assert right(spec.scene.source.stated(), calls) == known


def test_the_demonstration_asks_the_question_of_an_example() -> None:
    assert json.loads((EXAMPLES / "vqa-torch.json").read_text()) == QUESTION


def test_there_is_an_example_for_each_renderer_a_kind_and_several_questions() -> None:
    specs = [parse(json.loads(path.read_text())) for path in EXAMPLES.glob("vqa-*.json")]
    assert {spec.attack.renderer for spec in specs} == {"torch", "pyrender"}
    assert any(asked(spec).leave_kind for spec in specs)
    assert any(len(asked(spec).asked) > 1 for spec in specs)
