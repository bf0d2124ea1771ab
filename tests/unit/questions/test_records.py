"""CLEVR's question files: read, written, and refused."""

import json
from pathlib import Path

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack_questions.clevr.records import Info
from scene_attack_questions.generator import QuestionFile
from scene_attack_questions.program import Node

OFFICIAL = {
    "info": {
        "split": "val",
        "license": "Creative Commons Attribution (CC BY 4.0)",
        "version": "1.0",
        "date": "2/14/2017",
    },
    "questions": [
        {
            "image_index": 2,
            "program": [
                {"inputs": [], "function": "scene", "value_inputs": []},
                {"inputs": [0], "function": "filter_size", "value_inputs": ["small"]},
                {"inputs": [1], "function": "unique", "value_inputs": []},
                {"inputs": [2], "function": "same_color", "value_inputs": []},
                {"inputs": [3], "function": "exist", "value_inputs": []},
            ],
            "question_index": 20,
            "image_filename": "CLEVR_val_000002.png",
            "question_family_index": 31,
            "split": "val",
            "answer": "no",
            "question": "Is anything else the same color as the small thing?",
        },
    ],
}
"""A file as those of CLEVR v1.0 are: their fields, in their order, with other values."""


def stored(tmp_path: Path, question: dict) -> Path:
    path = tmp_path / "questions.json"
    path.write_text(json.dumps({"info": OFFICIAL["info"], "questions": [question]}))
    return path


def rewritten(tmp_path: Path, path: Path) -> list[dict]:
    QuestionFile.read(path).write(tmp_path / "again.json")
    found = json.loads((tmp_path / "again.json").read_text())
    assert found["info"] == OFFICIAL["info"]
    return found["questions"]


def test_an_official_file_is_written_as_it_was_read(tmp_path: Path) -> None:
    path = stored(tmp_path, OFFICIAL["questions"][0])
    (question,) = QuestionFile.read(path).questions
    assert question.program.nodes[1] == Node("filter_size", (0,), ("small",))
    question.program.check()
    assert rewritten(tmp_path, path) == OFFICIAL["questions"]


def test_a_test_question_without_answer_and_program_stays_without(tmp_path: Path) -> None:
    bare = {name: OFFICIAL["questions"][0][name] for name in ("split", "image_index", "image_filename", "question")}
    assert rewritten(tmp_path, stored(tmp_path, bare)) == [bare]


@pytest.mark.parametrize(("answer", "word"), [(True, "yes"), (False, "no"), (3, "3"), (0, "0"), ("cube", "cube")])
def test_the_generator_s_own_form_is_written_as_the_published_one(answer, word: str, tmp_path: Path) -> None:
    official = OFFICIAL["questions"][0]
    program = [
        {"type": node["function"], "inputs": node["inputs"], "_output": 0}
        | ({"side_inputs": node["value_inputs"]} if node["value_inputs"] else {})
        for node in official["program"]
    ]
    theirs = official | {
        "answer": answer,
        "program": program,
        "template_filename": "x.json",
        "image": "CLEVR_val_000002",
    }
    expected = official | {"answer": word, "template_filename": "x.json", "image": "CLEVR_val_000002"}
    assert rewritten(tmp_path, stored(tmp_path, theirs)) == [expected]


def test_generated_questions_are_read_as_they_were_written(asked, tmp_path: Path) -> None:
    questions = tuple(question for _, of_scene in asked[:40] for question in of_scene)
    file = QuestionFile(info=Info(split="new", version="1.0", date="", license=""), questions=questions)
    file.write(tmp_path / "questions.json")
    assert QuestionFile.read(tmp_path / "questions.json") == file
    (first, *_) = json.loads((tmp_path / "questions.json").read_text())["questions"]
    assert set(first) == set(OFFICIAL["questions"][0])


@pytest.mark.parametrize(
    ("change", "field", "said"),
    [
        ({"answer": "perhaps"}, "questions.0.answer", "there is no answer 'perhaps'"),
        ({"answer": 11}, "questions.0.answer", "there is no answer '11'"),
        ({"program": [{"function": "scene", "inputs": [None]}]}, "questions.0.program", "program.0: its inputs"),
        ({"program": 3}, "questions.0.program", "list of functions"),
        ({"image_index": "first"}, "questions.0.image_index", "integer"),
    ],
)
def test_a_damaged_file_is_refused_with_the_field(change: dict, field: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest) as caught:
        QuestionFile.read(stored(tmp_path, OFFICIAL["questions"][0] | change))
    assert caught.value.field == field
    assert said in caught.value.detail
