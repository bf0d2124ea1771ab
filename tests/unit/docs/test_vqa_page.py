"""docs/vqa.md against the code: its example runs, its tables and numbers are those of the code."""

import json
import re
from collections import Counter
from pathlib import Path

import pytest

from scene_attack.runs.spec import parse
from scene_attack_questions.clevr.description import scene_of
from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.program import FUNCTIONS
from scene_attack_questions.source import Clevr
from scene_attack_questions.text import WORDS

PAGE = (Path(__file__).parents[3] / "docs" / "vqa.md").read_text("utf-8")


def test_the_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.M | re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(example.replace("range(100)", "range(3)"), "vqa.md", "exec"), {})
    assert len(json.loads((tmp_path / "CLEVR_new_questions.json").read_text())["questions"]) == 30


def test_the_scene_of_ones_own_is_a_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = re.findall(r'^```python title="scene_of_mine.py"\n(.*?)^```$', PAGE, re.M | re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "scene_of_mine.py", "exec"), {})
    spec = parse(json.loads((tmp_path / "mine.json").read_text()))
    assert isinstance(spec.scene.source, Clevr)
    record = spec.scene.source.stated()
    assert [one.color for one in record.objects] == ["red", "blue", "green"]
    assert spec.scene.model_copy(update={"source": None}) == scene_of(record)


def test_every_function_is_in_the_table() -> None:
    rows = re.findall(r"^\| (`.*?) \|", PAGE, re.M)
    assert set(FUNCTIONS) <= {name for row in rows for name in re.findall(r"`(\w+)`", row)}


def test_the_families_are_as_many_as_said() -> None:
    said = {
        kind: int(count)
        for kinds, count in re.findall(r"^\| (`.*?) \| (\d+)(?: each)? \|", PAGE, re.M)
        for kind in re.findall(r"`(\w+)`", kinds)
    }
    assert said == Counter(family.kind for family in FAMILIES)


def test_words_and_answers_are_as_many_as_said() -> None:
    assert f"has {len(WORDS) - 1} words" in PAGE
    assert f"{len(ANSWERS)} answers" in PAGE
