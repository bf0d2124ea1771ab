"""The programs of `examples/`, each run in an empty folder."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
SAID = {
    "campaign_to_frame": r" +attack  azimuth original attacked outcome\n(.*fgsm +0\.[39] +[a-e]  .*\n){4}",
    "own_loop": r"right minus left: (?P<before>\S+) → (?P<after>\S+)\n",
    "own_mesh": r".+ → .+, verified: True\np = 0\.\d+ after \d+ steps\n",
    "own_network": r"module: elk → [abcd]\w+ changed\nfunction: elk → [abcd]\w+ fooled\n",
}


def test_every_program_is_run_and_short() -> None:
    programs = sorted((ROOT / "examples").glob("*.py"))
    assert [path.stem for path in programs] == sorted(SAID)
    assert all(10 <= len(path.read_text("utf-8").splitlines()) <= 30 for path in programs)


@pytest.mark.parametrize("name", SAID)
def test_a_program_says_what_it_found(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-P", "-W", "error", str(ROOT / f"examples/{name}.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    said = re.fullmatch(SAID[name], done.stdout)
    assert said is not None, done.stdout
    if "before" in said.groupdict():
        assert float(said["after"]) > float(said["before"])
