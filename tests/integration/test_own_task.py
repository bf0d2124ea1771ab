"""A task of a plug-in of one file, `segmenter.py`, whose network gives a map in place of scores, in the real stack.

No file of the library knows of it: its fields of requests and results, its tables and its part of a page are its own.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.installed import installed
from tests.integration.conftest import serving
from tests.unit.client.command_line import Done, process

pytestmark = pytest.mark.integration

HERE = Path(__file__).parent
SPEC: dict[str, Any] = {
    "scene": {
        "objects": [{"mesh": "primitive/sphere", "material": "plastic", "scale": 0.35}],
        "camera": {"size": [32, 32]},
    },
    "target": {"name": "grey-segmenter", "ask": {"share": 0.118}},
    "attack": {"renderer": "torch", "groups": ["normals"], "method": "fgsm", "steps": 40},
}
"""The network sees the sphere in 11.9 % of the image."""


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The folder in which the plug-in is installed."""
    folder = installed(tmp_path_factory.mktemp("plugins"), {"segmenter": (HERE / "segmenter.py").read_text()})
    shutil.copy(HERE / "segmenter.html", folder)
    return str(folder)


@pytest.fixture
def run(plugins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("PYTHONPATH", plugins)

    def command(*arguments: str, **changes: Any) -> Done:
        (tmp_path / "job.json").write_text(json.dumps(SPEC | changes))
        return process(arguments[0], str(tmp_path / "job.json"), *arguments[1:])

    return command


def test_its_answer_is_attacked_verified_and_replayed(run: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("run", "--out", str(out))
    assert done.returncode == 0, done.stderr
    result = json.loads((out / "result.json").read_text())
    assert (result["verdict"]["outcome"], result["verdict"]["verified"]) == ("fooled", True)
    assert (result["original"]["label"], result["attacked"]["label"]) == ("seen", "gone")
    shares = result["tasks"]["segmentation"]
    assert shares["after"] < 0.118 < shares["before"]
    assert (out / "mask.png").exists()
    assert f"Seen in {shares['before']:.1%} before" in done.stdout
    again = process("replay", str(out))
    assert again.returncode == 0, again.stderr


def test_a_plan_states_it_and_what_it_is_not_asked_is_refused_by_its_field(run: Any) -> None:
    assert "It answers seen or gone" in run("plan").stdout
    name = "grey-segmenter"
    for ask, field in (({"question": "Is it?"}, "target.ask.share"), ({"share": 1}, "target.ask.share")):
        refused = run("plan", target={"name": name, "ask": ask})
        assert (refused.returncode, field in refused.stderr) == (2, True), refused.stderr
    unasked = run("plan", target={"name": name})
    assert (unasked.returncode, "target.ask.share: is required" in unasked.stderr) == (2, True)


@pytest.mark.usefixtures("run")
def test_its_network_is_tried_by_its_own_example() -> None:
    done = process("targets", "check", "grey-segmenter", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["asked"] == "Is something in 5% of the image?"


def test_the_service_draws_it_and_serves_its_fields(plugins: str, tmp_path: Path) -> None:
    # without the questions, it is the only task that adds anything
    environ = {"PYTHONPATH": plugins, "SCENE_ATTACK_WITHOUT_PLUGINS": "questions"}
    with serving(tmp_path / "data", **environ) as stack:
        job = stack.ended(stack.submit(SPEC))
        assert (job["state"], job["name"]) == ("succeeded", "Is something in 12% of the image?")
        share = job["result"]["tasks"]["segmentation"]["after"]
        page = stack.client.get(f"/jobs/{job['id']}").text
        assert f"and in {100 * share:.1f} % after" in page.replace("\u00a0", " ")
        served = stack.client.get("/openapi.json").json()["components"]["schemas"]
        assert {"Look", "Planned", "Segmented"} < served.keys()
        assert served["TargetChoice"]["properties"]["ask"]["anyOf"][0] == {"$ref": "#/components/schemas/Look"}
