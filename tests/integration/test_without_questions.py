"""The product with the plug-in of questions left out."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.integration.specs import QUICK
from tests.unit.client.command_line import process

pytestmark = pytest.mark.integration
ROOT = Path(__file__).parents[2]
WITHOUT = ("--without-plugin", "questions")


def test_its_network_is_not_listed_and_all_others_are() -> None:
    names = [
        {target["name"] for target in json.loads(process(*left_out, "targets", "--json").stdout)}
        for left_out in ((), WITHOUT)
    ]
    assert names[0] - names[1] == {"iep"}


def test_a_job_runs_as_with_it(tmp_path: Path) -> None:
    (tmp_path / "job.json").write_text(json.dumps(QUICK))
    answers = []
    for left_out in ((), WITHOUT):
        out = tmp_path / f"out{len(left_out)}"
        done = process(*left_out, "run", str(tmp_path / "job.json"), "--out", str(out))
        assert done.returncode == 0, done.stderr
        result = json.loads((out / "result.json").read_text())
        answers.append({name: result[name] for name in ("spec", "verdict", "original", "attacked", "change")})
    assert answers[0] == answers[1]


DOCUMENT = """
from scene_attack.runs.set_up import set_up
from scene_attack_service.settings import DEFAULTS

set_up(DEFAULTS.model_copy(update={"without_plugins": ("questions",)}))
from scene_attack_api.openapi import document

print(document(), end="")
"""
FIELDS = {
    ("Scene", "source"),
    ("TargetChoice", "ask"),
    ("Grid", "generate"),
    ("JobPlan", "tasks"),
    ("Result", "tasks"),
}
"""The fields in which a task may add something."""


def test_the_api_is_that_of_openapi_yaml_less_its_fields() -> None:
    done = subprocess.run([sys.executable, "-c", DOCUMENT], capture_output=True, text=True, check=True)
    served, whole = yaml.safe_load(done.stdout), yaml.safe_load((ROOT / "openapi.yaml").read_text())
    assert served["paths"] == whole["paths"]
    ours, every = served["components"]["schemas"], whole["components"]["schemas"]
    assert ours.keys() < every.keys()
    assert {"Questions", "QuestionsResult", "Clevr"} < every.keys() - ours.keys()
    for name, field in FIELDS:
        del ours[name]["properties"][field], every[name]["properties"][field]
    assert ours == {name: every[name] for name in ours}


def test_a_name_that_there_is_not_is_refused() -> None:
    done = process("--without-plugin", "question", "targets")
    assert done.returncode == 2
    assert "SCENE_ATTACK_WITHOUT_PLUGINS: there is no plug-in 'question'" in done.stderr
    assert "questions" in done.stderr
