"""The files of CONTRIBUTING.md, taken out of it as they stand, in the real stack; and files that are no good."""

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.conftest import Stack, serving
from tests.integration.specs import QUICK, scene

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
BLOCKS = dict(
    re.findall(r'^```python title="(\w+\.py)"\n(.*?)^```$', (ROOT / "CONTRIBUTING.md").read_text(), re.M | re.S)
)
FILES = {name: code for name, code in BLOCKS.items() if not name.startswith("test_")}
ADDS = {
    "random_search.py": ["method random-search"],
    "tint.py": ["renderer tint"],
    "brightest_channel.py": ["target brightest-channel"],
}
ON_PIXELS = {"renderer": "image", "base_renderer": "pyrender", "steps": 4}
TARGET = {"name": "brightest-channel"}
JOBS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "the attack": ({"attack": ON_PIXELS | {"method": "random-search"}}, {"random_search.py"}),
    "the renderer": ({"attack": {"renderer": "tint", "base_renderer": "pyrender", "steps": 4}}, {"tint.py"}),
    "the target": ({"attack": ON_PIXELS, "target": TARGET}, {"brightest_channel.py"}),
    "all three": (
        {"attack": {"renderer": "tint", "method": "random-search", "steps": 40, "spread": 0.05}, "target": TARGET},
        set(FILES),
    ),
}
"""What each job adds to a scene, and the files its result must name."""

SHAPELESS = """
from services.rendering.declaration import Group

Group(name="fog", unit="1", words="fog")
"""
LATE = FILES["tint.py"].replace('name="tint"', 'name="late"', 1)
TAKEN = FILES["random_search.py"].replace("from __future__ import annotations", "").replace("random-search", "fgsm")
BROKEN = {
    "fails.py": ("raise ImportError('no module named brdf')", "line 1: ImportError: no module named brdf"),
    "is_no_python.py": ("def (:", "SyntaxError"),
    "is_no_text.py": (r"raise ValueError('\udc80' + 'x' * 999_999)", r"line 1: ValueError: \udc80xxx"),
    "shapeless.py": (SHAPELESS, "group 'fog' declares no shape"),
    "twice.py": (LATE + TAKEN, "there is a method 'fgsm' already"),
}
"""Files that cannot be loaded, and what is said of each. The last registers a renderer before it fails."""


def write(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, code in files.items():
        (folder / name).write_text(code)
    return folder


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack with the files of CONTRIBUTING.md beside files that are no good, and a path where nothing is."""
    folder = write(tmp_path_factory.mktemp("extensions"), FILES | {name: code for name, (code, _) in BROKEN.items()})
    paths = os.pathsep.join([str(folder), str(folder / "nowhere.py")])
    with serving(tmp_path_factory.mktemp("extended") / "data", SCENE_ATTACK_EXTENSIONS=paths) as stack:
        yield stack


def test_the_page_has_a_file_and_a_test_of_each_kind() -> None:
    assert set(FILES) == set(ADDS)
    assert set(BLOCKS) == set(FILES) | {f"test_{name}" for name in FILES}


def test_the_tests_of_the_page_pass(tmp_path: Path) -> None:
    environ = {"SCENE_ATTACK_EXTENSIONS": str(write(tmp_path / "mine", FILES)), "PYTHONPATH": str(ROOT)}
    tests = write(tmp_path / "tests", {name: code for name, code in BLOCKS.items() if name not in FILES})
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml")]
    done = subprocess.run([*command, str(tests)], cwd=ROOT, env=os.environ | environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "6 passed" in done.stdout


@pytest.mark.parametrize("name", JOBS)
def test_a_job_runs_with_it(extended: Stack, name: str) -> None:
    asked, files = JOBS[name]
    job = extended.ended(extended.submit({"scene": scene()} | asked))
    assert job["state"] == "succeeded", job["failure"]
    result = job["result"]
    assert result["verdict"]["stopped"] in ("verified", "steps")
    assert result["verdict"]["verified"] == (result["verdict"]["stopped"] == "verified")
    assert result["cost"]["queries"] > 0
    assert result["measured"]["image_error"] == 0
    digests = {file: hashlib.sha256(FILES[file].encode()).hexdigest() for file in files}
    assert result["provenance"]["extensions"] == digests
    assert extended.client.get(f"/jobs/{job['id']}").status_code == 200


def test_an_adversary_of_the_target_is_verified(extended: Stack) -> None:
    """A grey sphere on grey is as red as green and blue, so that the first step on its pixels is enough."""
    job = extended.ended(extended.submit({"scene": scene()} | JOBS["the target"][0]))
    assert job["outcome"]["verified"]
    assert {job["outcome"]["before"], job["outcome"]["after"]} < {"red", "green", "blue"}


def test_what_they_add_is_known_everywhere(extended: Stack) -> None:
    targets = extended.client.get("/v1/targets").json()["items"]
    assert {target["name"] for target in targets} >= {"efficientnet-lite0", "brightest-channel"}
    schemas = extended.client.get("/openapi.json").json()["components"]["schemas"]
    assert schemas["RandomSearch"]["properties"]["spread"]["description"]
    assert "tint" in schemas["Fgsm"]["properties"]["renderer"]["enum"]
    job_id = extended.submit({"scene": scene()} | JOBS["the renderer"][0])
    assert extended.job(job_id)["spec"]["attack"]["learning_rate"] == {"tint": 0.01}
    extended.ended(job_id)
    assert "p of colour of the filter" in extended.client.get(f"/jobs/{job_id}").text
    assert "tint fgsm" in extended.client.get("/").text
    wrong = {"scene": scene(), "attack": {"method": "random-search", "spread": -1}}
    answer = extended.client.post("/v1/jobs", json=wrong)
    assert [error["field"] for error in answer.json()["errors"]] == ["attack.spread"]


def test_a_file_that_is_no_good_is_left_out_and_said_so(extended: Stack) -> None:
    ready = extended.client.get("/readyz")
    assert ready.status_code == 200
    said = {one["file"]: one for one in ready.json()["extensions"]}
    assert set(said) == {*FILES, *BROKEN, "nowhere.py"}
    for name, code in FILES.items():
        assert said[name]["error"] is None
        assert said[name]["adds"] == ADDS[name]
        assert said[name]["sha256"] == hashlib.sha256(code.encode()).hexdigest()
    log = [json.loads(line) for line in extended.log.read_text().splitlines() if line.startswith("{")]
    logged = {Path(one["file"]).name: one for one in log if one["event"] == "extension left out"}
    for name, (_, why) in BROKEN.items():
        assert why in said[name]["error"]
        assert said[name]["adds"] == []
        assert why in logged[name]["error"]
    assert "No such file" in said["nowhere.py"]["error"]
    assert {one["process"] for one in log if one["event"] == "extension left out"} == {"api", "warm", "job"}


def test_what_a_file_registered_before_it_failed_is_taken_back(extended: Stack) -> None:
    answer = extended.client.post("/v1/jobs", json={"scene": scene(), "attack": {"renderer": "late"}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "attack.renderer"
    assert "late" not in answer.json()["errors"][0]["detail"].partition("there are")[2]
    assert extended.ended(extended.submit(QUICK))["state"] == "succeeded"  # fgsm is still the built-in one


def test_jobs_of_an_extension_that_is_gone_stay_in_the_record(tmp_path: Path) -> None:
    folder = write(tmp_path / "extensions", FILES)
    with serving(tmp_path / "data", SCENE_ATTACK_EXTENSIONS=str(folder)) as before:
        job_id = before.submit({"scene": scene()} | JOBS["all three"][0])
        stored = before.ended(job_id)
    with serving(tmp_path / "data") as after:
        assert after.job(job_id) == stored
        assert [job["id"] for job in after.client.get("/v1/jobs").json()["items"]] == [job_id]
        assert after.client.get("/").status_code == after.client.get(f"/jobs/{job_id}").status_code == 200
        assert after.client.get("/readyz").json()["extensions"] == []
