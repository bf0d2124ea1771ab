import json
import re
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from scene_attack.errors import InvalidRequest
from tests.unit.training.iep.small import RECIPE, SEED
from training import __main__
from training.__main__ import app
from training.iep import recipe

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["iep", *arguments])
    if isinstance(done.exception, InvalidRequest):
        raise done.exception
    return done.exit_code, done.stdout


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recipe, "RECIPE", RECIPE)


def test_the_command_goes_on_writes_the_checkpoint_and_checks_it(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = copied.parent
    (copied / "generator.checkpoint").unlink()
    with monkeypatch.context() as hurried:
        ticks = count(step=100.0)
        hurried.setattr(__main__, "time", SimpleNamespace(monotonic=lambda: next(ticks)))
        code, said = run("--out", str(out), "--seed", str(SEED), "--seconds-budget", "10")
    assert (code, said) == (0, "not finished; the same command goes on\n")
    assert not (out / "iep.safetensors").exists()
    code, said = run("--out", str(out), "--seed", str(SEED))
    assert code == 0
    rows = re.findall(r"^\| (\w+) \|", said, re.MULTILINE)
    assert rows[:2] == ["questions", "overall"]
    facts = json.loads((out / "iep.json").read_text())
    assert facts["bytes"] == (out / "iep.safetensors").stat().st_size < 10_000_000
    assert facts["command"] == f"python -m training iep --seed {SEED}"
    assert facts["check"]["programs"]["of"] == 2 * RECIPE.questions
    weights = ("--check", "--weights", str(out / "iep.safetensors"), "--out", str(out))
    assert run(*weights) == (0, said)
    facts["check"]["programs"]["wilson"] = [0.9, 1.0]
    (out / "iep.json").write_text(json.dumps(facts))
    code, said = run(*weights)
    assert code == 1
    assert "programs is 0.0000, not within 0.9000 and 1.0000" in said


def test_weights_are_for_the_check_only(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="it is for --check"):
        run("--weights", "some.safetensors", "--out", str(tmp_path))
