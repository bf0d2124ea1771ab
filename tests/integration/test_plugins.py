"""Plug-ins and networks of one's own in the real stack: the files of CONTRIBUTING.md, taken out of it as they stand,
targets that take memory in each of the ways in which it is counted, an attack that kills its process, folders of
networks, and what is no good.
"""

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from sqlite3 import connect
from typing import Any

import pytest

from scene_attack_api.main import create_app
from scene_attack_service.jobs.leases import MAX_ATTEMPTS
from scene_attack_service.settings import Settings
from tests.installed import installed
from tests.integration.conftest import Stack, serving
from tests.integration.specs import QUICK, scene
from tests.unit.api.conftest import serving as served
from tests.unit.client.command_line import Done, cli, process
from tests.unit.targets.custom.small_network import LABELS, folder, save_onnx, save_pt2

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
BLOCKS = dict(
    re.findall(r'^```python title="(\w+\.py)"\n(.*?)^```$', (ROOT / "CONTRIBUTING.md").read_text(), re.M | re.S)
)
TESTS = {name: code for name, code in BLOCKS.items() if name.startswith("test_")}
MODULES = {
    name.removesuffix(".py").replace("_", "-"): code for name, code in BLOCKS.items() if not name.startswith("test_")
}
ADDS = {
    "random-search": ["method random-search"],
    "tint": ["renderer tint"],
    "brightest-channel": ["target brightest-channel"],
}
ON_PIXELS = {"renderer": "image", "base_renderer": "pyrender", "steps": 4}
TARGET = {"name": "brightest-channel"}
JOBS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "the attack": ({"attack": ON_PIXELS | {"method": "random-search"}}, {"random-search"}),
    "the renderer": ({"attack": {"renderer": "tint", "base_renderer": "pyrender", "steps": 4}}, {"tint"}),
    "the target": ({"attack": ON_PIXELS, "target": TARGET}, {"brightest-channel"}),
    "all three": (
        {"attack": {"renderer": "tint", "method": "random-search", "steps": 40, "spread": 0.05}, "target": TARGET},
        set(MODULES),
    ),
}
"""What each job adds to a scene, and the plug-ins its result must name."""

SHAPELESS = """
from scene_attack.rendering.declaration import Group

Group(name="fog", unit="1", words="fog")
"""
LATE = MODULES["tint"].replace('name="tint"', 'name="late"', 1)
TAKEN = MODULES["random-search"].replace("from __future__ import annotations", "").replace("random-search", "fgsm")
BROKEN = {
    "fails": ("raise ImportError('no module named brdf')", "line 1: ImportError: no module named brdf"),
    "is-no-python": ("def (:", "SyntaxError"),
    "is-no-text": (r"raise ValueError('\udc80' + 'x' * 999_999)", r"line 1: ValueError: \udc80xxx"),
    "of-another-interface": ("INTERFACE = 2", "is written for interface 2 of plug-ins; this is interface 1"),
    "shapeless": (SHAPELESS, "group 'fog' declares no shape"),
    "twice": (LATE + TAKEN, "there is a method 'fgsm' already"),
}
"""Plug-ins that cannot be loaded, and what is said of each. The last registers a renderer before it fails."""


def write(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, code in files.items():
        (folder / name).write_text(code)
    return folder


LIMIT = 3 * 2**30
SAID = "more memory than SCENE_ATTACK_JOB_MEMORY_BYTES allows a process, 3 GiB"
TAKES_MEMORY = (
    MODULES["brightest-channel"].replace("brightest-channel", "takes-nothing")
    + '''
import mmap
import sys

HELD = []
"""What the targets of this process have taken."""


def reserve():  # as PyTorch's CUDA build does: addresses at which nothing can be read or written
    HELD.append(mmap.mmap(-1, 64 * 2**30, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, prot=0))


def torch_block():
    import torch

    HELD.append(torch.empty(64 * 2**30, dtype=torch.uint8))


def numpy_block():
    import numpy

    HELD.append(numpy.empty(64 * 2**30, numpy.uint8))


def pieces():
    import torch

    [torch.ones(2**27, dtype=torch.uint8) for _ in range(32)]


def private_map():
    HELD.append(mmap.mmap(-1, 64 * 2**30, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS))


def shared_map():
    HELD.append(mmap.mmap(-1, 4 * 2**30))
    for start in range(0, 4 * 2**30, 2**26):
        HELD[-1][start : start + 2**26] = bytes(2**26)


def target(name, take, process):
    @register_target(CARD.model_copy(update={"name": name}), lambda: LABELS)
    def load_after_taking(dtype):
        if process in sys.orig_argv:
            take()
        return load(dtype)


for take in (reserve, torch_block, numpy_block, pieces, private_map, shared_map):
    target("job-" + take.__name__, take, "scene_attack_worker.job_process")
for take in (torch_block, shared_map):
    target("check-" + take.__name__, take, "scene_attack_service.jobs.warm_process")
'''
)


DEADLY = """
import os, signal
from typing import Literal
from scene_attack.attacks.fgsm import FGSM
from scene_attack.plugin import register_attack

INTERFACE = 1

@register_attack
class Deadly(FGSM):
    method: Literal["deadly"] = "deadly"

    def step(self, problem, state, evaluation):
        os.kill(os.getpid(), signal.SIGKILL)
"""
"""An attack that kills its process at its first step."""


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A program, the same as ONNX, a folder without a card, and a program whose labels do not fit."""
    root = tmp_path_factory.mktemp("mine")
    save_pt2(folder(root, "program") / "model.pt2")
    save_onnx(folder(root, "onnx") / "model.onnx")
    (root / "empty").mkdir()
    save_pt2(folder(root, "short", labels=LABELS[:3]) / "model.pt2")
    return root


@pytest.fixture(scope="module")
def extended(mine: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack of 3 GiB a process with the plug-ins of CONTRIBUTING.md, targets that take memory when they are loaded,
    an attack that kills its process, plug-ins that are no good, and the networks of `mine`.
    """
    harmful = {"takes-memory": TAKES_MEMORY, "deadly": DEADLY}
    modules = MODULES | harmful | {name: code for name, (code, _) in BROKEN.items()}
    environ = {
        "PYTHONPATH": str(installed(tmp_path_factory.mktemp("plugins"), modules)),
        "SCENE_ATTACK_JOB_MEMORY_BYTES": str(LIMIT),
        "SCENE_ATTACK_TARGETS": str(mine),
    }
    with serving(tmp_path_factory.mktemp("extended") / "data", **environ) as stack:
        yield stack


def test_the_page_has_a_file_and_a_test_of_each_kind() -> None:
    assert set(MODULES) == set(ADDS)
    assert set(TESTS) == {f"test_{name.replace('-', '_')}.py" for name in MODULES}


def test_the_tests_of_the_page_pass(tmp_path: Path) -> None:
    environ = {"PYTHONPATH": os.pathsep.join([str(installed(tmp_path / "mine", MODULES)), str(ROOT)])}
    tests = write(tmp_path / "tests", TESTS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml")]
    done = subprocess.run([*command, str(tests)], cwd=ROOT, env=os.environ | environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "6 passed" in done.stdout


@pytest.mark.parametrize("name", JOBS)
def test_a_job_runs_with_it(extended: Stack, name: str) -> None:
    asked, used = JOBS[name]
    job = extended.ended(extended.submit({"scene": scene()} | asked))
    assert job["state"] == "succeeded", job["failure"]
    result = job["result"]
    assert result["verdict"]["stopped"] in ("verified", "steps")
    assert result["verdict"]["verified"] == (result["verdict"]["stopped"] == "verified")
    assert result["cost"]["queries"] > 0
    assert result["measured"]["image_error"] == 0
    digests = {f"{plugin} 1.0": hashlib.sha256(MODULES[plugin].encode()).hexdigest() for plugin in used}
    assert result["provenance"]["plugins"] == digests
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
    assert "tint" in schemas["FGSM"]["properties"]["renderer"]["enum"]
    job_id = extended.submit({"scene": scene()} | JOBS["the renderer"][0])
    assert extended.job(job_id)["spec"]["attack"]["learning_rate"] == {"tint": 0.01}
    extended.ended(job_id)
    assert "<strong>colour of the filter</strong> largest change" in extended.client.get(f"/jobs/{job_id}").text
    assert "tint fgsm" in extended.client.get("/").text
    wrong = {"scene": scene(), "attack": {"method": "random-search", "spread": -1}}
    answer = extended.client.post("/v1/jobs", json=wrong)
    assert [error["field"] for error in answer.json()["errors"]] == ["attack.spread"]


def test_a_plugin_that_is_no_good_is_left_out_and_said_so(extended: Stack) -> None:
    ready = extended.client.get("/readyz")
    assert ready.status_code == 200
    said = {one["name"]: one for one in ready.json()["plugins"]}
    assert set(said) >= {*MODULES, *BROKEN, "takes-memory", "deadly"}
    for name, code in MODULES.items():
        assert said[name]["error"] is None
        assert said[name]["package"] == f"{name} 1.0"
        assert said[name]["adds"] == ADDS[name]
        assert said[name]["sha256"] == hashlib.sha256(code.encode()).hexdigest()
    log = [json.loads(line) for line in extended.log.read_text().splitlines() if line.startswith("{")]
    logged = {one["plugin"]: one for one in log if one["event"] == "plug-in left out"}
    for name, (_, why) in BROKEN.items():
        assert why in said[name]["error"]
        assert said[name]["adds"] == []
        assert why in logged[name]["error"]
    assert {one["process"] for one in log if one["event"] == "plug-in left out"} == {"api", "warm", "job"}


def test_what_a_plugin_registered_before_it_failed_is_taken_back(extended: Stack) -> None:
    answer = extended.client.post("/v1/jobs", json={"scene": scene(), "attack": {"renderer": "late"}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "attack.renderer"
    assert "late" not in answer.json()["errors"][0]["detail"].partition("there are")[2]
    assert extended.ended(extended.submit(QUICK))["state"] == "succeeded"  # fgsm is still the built-in one


def test_jobs_of_a_plugin_that_is_gone_stay_in_the_record(extended: Stack, redis_url: str, tmp_path: Path) -> None:
    """A copy of the service's folder, served without the plug-ins."""
    job_id = extended.submit({"scene": scene()} | JOBS["all three"][0])
    stored = extended.ended(job_id)
    done = cli("backup", str(tmp_path / "copy"), SCENE_ATTACK_DATA=str(extended.data))
    assert done.returncode == 0, done.stderr
    with served(create_app(Settings(data=tmp_path / "copy", redis_url=redis_url))) as after:
        assert after.get(f"/v1/jobs/{job_id}").json() == stored
        assert after.get("/v1/jobs").json()["items"][0]["id"] == job_id
        assert after.get("/").status_code == after.get(f"/jobs/{job_id}").status_code == 200
        assert not set(MODULES) & {one["name"] for one in after.get("/readyz").json()["plugins"]}


def test_addresses_that_are_not_used_cost_a_job_nothing(extended: Stack) -> None:
    process = extended.one("scene_attack_worker.job_process")
    job = extended.ended(extended.submit(QUICK | {"target": {"name": "job-reserve"}}))
    assert job["state"] == "succeeded", job["failure"]
    assert process.memory_info().vms > 64 * 2**30


@pytest.mark.parametrize("way", ["torch_block", "numpy_block", "pieces", "private_map", "shared_map"])
def test_a_job_that_takes_too_much_ends_and_names_the_setting(extended: Stack, way: str) -> None:
    job = extended.ended(extended.submit(QUICK | {"target": {"name": f"job-{way}"}}))
    assert job["failure"] == {"kind": "out-of-memory", "detail": f"the job needed {SAID}"}
    after = extended.ended(extended.submit(QUICK | {"target": {"name": "brightest-channel"}}))
    assert after["state"] == "succeeded", after["failure"]


@pytest.mark.parametrize("way", ["torch_block", "shared_map"])
def test_a_request_that_takes_too_much_is_refused_before_it_is_a_job(extended: Stack, way: str) -> None:
    answer = extended.client.post("/v1/jobs", json=QUICK | {"target": {"name": f"check-{way}"}})
    assert answer.status_code == 422
    detail = f"rendering it once takes {SAID}; ask for a smaller image, a smaller environment map or fewer objects"
    assert answer.json()["errors"] == [{"field": "scene", "detail": detail}]


def test_a_job_that_kills_its_process_every_time_fails_by_name(extended: Stack) -> None:
    job_id = extended.submit(QUICK | {"attack": QUICK["attack"] | {"method": "deadly"}})
    with closing(connect(extended.data / "jobs.sqlite")) as record, record:  # it has died before, and further on
        record.execute("UPDATE jobs SET lost = ?, furthest = ? WHERE id = ?", (MAX_ATTEMPTS - 2, 1 << 40, job_id))
    job = extended.ended(job_id)
    assert (job["state"], job["failure"]["kind"], job["attempt"]) == ("failed", "worker-lost", 2)
    assert extended.ended(extended.submit(QUICK))["state"] == "succeeded"


def test_the_service_says_what_it_found(extended: Stack) -> None:
    folders = {one["name"]: one for one in extended.client.get("/readyz").json()["targets"]}
    assert {name: one["error"] is None for name, one in folders.items()} == {
        "program": True, "onnx": True, "short": True, "empty": False,
    }  # fmt: skip
    assert folders["empty"]["error"].startswith("card.json: there is no such file")
    listed = {one["name"]: one for one in extended.client.get("/v1/targets").json()["items"]}
    assert listed["program"]["card_sha256"] == folders["program"]["card_sha256"]
    assert (listed["program"]["differentiable"], listed["onnx"]["differentiable"]) == (True, False)
    assert "empty" not in listed


def test_the_same_network_gives_the_same_adversary_in_both_formats(extended: Stack) -> None:
    attack = {"renderer": "image", "base_renderer": "pyrender", "method": "square", "epsilon": {"image": 0.3}}
    jobs = [
        extended.ended(extended.submit({"scene": scene(48), "target": {"name": name}, "attack": attack}))
        for name in ("program", "onnx")
    ]
    for job in jobs:
        assert job["state"] == "succeeded", job["failure"]
        assert job["outcome"]["verified"]
    one, two = (job["outcome"] for job in jobs)
    assert (one["before"], one["after"], one["steps"]) == (two["before"], two["after"], two["steps"])
    assert one["after_confidence"] == pytest.approx(two["after_confidence"], abs=1e-4)
    provenance = [job["result"]["provenance"] for job in jobs]
    assert provenance[0]["weights_sha256"] != provenance[1]["weights_sha256"]
    assert provenance[0]["card_sha256"] == provenance[1]["card_sha256"]


@pytest.mark.parametrize(
    ("name", "said"), [("empty", "is not available: card.json: there is no such file"), ("short", "[2, 3] is due")]
)
def test_a_network_that_cannot_be_used_is_refused_before_anything_is_queued(
    extended: Stack, name: str, said: str
) -> None:
    answer = extended.client.post("/v1/jobs", json={"scene": scene(48), "target": {"name": name}, "attack": ON_PIXELS})
    assert answer.status_code == 422
    assert said in json.dumps(answer.json(), ensure_ascii=False)
    assert "target.name" in answer.text
    assert not [job for job in extended.client.get("/v1/jobs").json()["items"] if job["target"] == name]


def test_the_command_line_tries_one(mine: Path) -> None:
    def check(*arguments: str) -> Done:
        words = ("targets", "check", *arguments, "--mesh", "primitive/sphere")
        return process(*words, SCENE_ATTACK_TARGETS=str(mine))

    done = check("onnx", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert not found["gradient"]
    assert "torch.export.save" in found["no_gradient"]
    assert {answer["label"] for answer in found["answers"]} == set(LABELS)
    assert "target left out" not in done.stderr
    done = check("short")
    assert done.returncode == 2
    assert "bad input: target.name: target 'short' returns torch.float32 [2, 5]" in done.stderr
