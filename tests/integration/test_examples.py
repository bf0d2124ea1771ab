"""The programs of `examples/`, each run in an empty folder, its notebook and its plug-in."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.installed import installed

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
SAID = {
    "campaign_to_frame": r" +attack  azimuth original attacked outcome\n(.*fgsm +0\.[39] +[a-e]  .*\n){4}",
    "own_attack": r"(fooled|changed|not fooled): the objective fell from (?P<after>\S+) to (?P<before>\S+)\n",
    "own_loop": r"right minus left: (?P<before>\S+) → (?P<after>\S+)\n",
    "own_mesh": r".+ → .+, verified: True\np = 0\.\d+ after \d+ steps\n",
    "own_network": r"module: elk → [abcd]\w+ changed\nfunction: elk → [abcd]\w+ fooled\n",
    "own_renderer": r"green → (red|blue): changed\n",
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


def test_the_notebook_has_no_outputs_and_its_cells_end_in_the_pictures() -> None:
    cells = json.loads((ROOT / "examples/notebook.ipynb").read_text("utf-8"))["cells"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in cells)
    names: dict[str, object] = {}
    *before, shown = ["".join(cell["source"]) for cell in cells]
    for code in before:
        exec(code, names)
    assert eval(shown, names)._repr_html_().count("data:image/png;base64,") == 3


def test_the_plugin_of_the_package_is_found_and_attacks(tmp_path: Path) -> None:
    package = ROOT / "examples/plugin_package"
    about = tomllib.loads((package / "pyproject.toml").read_text("utf-8"))["project"]
    [(name, module)] = about["entry-points"]["scene_attack.plugins"].items()
    assert name == module
    folder = installed(tmp_path / "site", {name: (package / f"{module}.py").read_text("utf-8")}, about["version"])
    attack = {"method": name, "renderer": "image", "steps": 20}
    spec = {"scene": {"objects": [{"mesh": "primitive/torus"}], "camera": {"size": [32, 32]}}, "attack": attack}
    command = [sys.executable, "-P", "-m", "scene_attack", "run", "-", "--out", str(tmp_path / "out")]
    done = subprocess.run(
        command,
        input=json.dumps(spec),
        env=os.environ | {"PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    objectives = [row["objective"] for row in json.loads((tmp_path / "out/result.json").read_text())["trace"]]
    assert min(objectives) < objectives[0], done.stderr
