"""The examples of every --help, run as they stand: only ids, addresses and the contents of files are the test's own."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
import trimesh

from scene_attack.attacks.run import saved_step
from scene_attack.cli.commands_page import commands, examples
from tests.integration.conftest import Stack, until
from tests.integration.specs import ENDLESS, QUICK, long, scene
from tests.integration.test_run import small
from tests.unit.client.command_line import cli
from tests.unit.scenes.scene_files import Room

pytestmark = pytest.mark.integration

EXAMPLES = [example for _, command in commands() for example in examples(command)]
ELSEWHERE = {
    "serve": "every integration test starts one",
    "SCENE_ATTACK_REDIS_URL": "test_many_machines starts them, and this address is another machine's",
    "demo": "test_demo runs it",
    "doctor": "test_command_line runs it",
    "convert": "tests/unit/blender runs it, where Blender is",
    "accuracy": "minutes of measurements; tests of services/scene_attack_accuracy run their parts",
    "assets fetch": "tests/unit/scenes/test_fetch runs it with packages of its own",
    "pg_restore": "a program of PostgreSQL; tests/unit/jobs restores a copy with it",
}
"""Examples that are not run here, by a word of them, and why. A unit test parses them."""
ID = "0f3c…"
GARDEN = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + 32 * bytes((128, 128, 128, 129))
"""A map of one colour, in Radiance's format."""


def _is_elsewhere(example: str) -> bool:
    return any(re.search(rf"(^|\s){word}\b", example) for word in ELSEWHERE)


class Reader:
    """A reader's folder, with small files under the names of the examples."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.left = [example for example in EXAMPLES if not _is_elsewhere(example)]
        self.environ = {"SCENE_ATTACK_DATA": str(folder / "data")}
        for name in ("examples", "out", "bin", "backups"):
            (folder / name).mkdir()
        (folder / "bin/scene-attack").write_text(f'#!/bin/sh\nexec {sys.executable} -m scene_attack "$@"\n')
        (folder / "bin/scene-attack").chmod(0o755)
        for file, content in (
            ("examples/torch-combined.json", small("torch-combined") | {"scene": scene()}),
            ("examples/torch-physical.json", small("torch-physical") | {"scene": scene()}),
            ("examples/image-fgsm.json", small("image-fgsm")),
            ("examples/campaign-small.json", campaign(QUICK)),
            ("spec.json", QUICK),
            ("campaign.json", campaign(QUICK)),
            ("poses.json", poses()),
        ):
            (folder / file).write_text(json.dumps(content))
        chair = trimesh.creation.icosphere(subdivisions=2).export(file_type="obj")
        (folder / "chair.obj").write_text(chair)
        (folder / "room.glb").write_bytes(Room().glb)
        (folder / "garden.hdr").write_bytes(GARDEN)
        with ZipFile(folder / "models.zip", "w") as models:
            models.writestr("chair.obj", chair)
            models.writestr("stool.obj", chair)

    def run(self, example: str, **words: str) -> str:
        """The standard output of an example of --help, in which words are replaced by the test's own."""
        self.left.remove(example)
        for word, own in words.items():
            assert word in example
            example = example.replace(word, own)
        return self.command(example)

    def command(self, text: str) -> str:
        """The standard output of one command, run in this process. It may read a file by `<`."""
        _, *arguments = shlex.split(text, comments=True)
        stdin = ""
        if "<" in arguments:
            *arguments, _, file = arguments
            stdin = (self.folder / file).read_text()
        with chdir(self.folder):
            done = cli(*arguments, stdin=stdin, **self.environ)
        assert done.returncode == 0, f"{text}\n{done.stdout}{done.stderr}"
        return done.stdout

    def shell(self, command: str) -> str:
        """The standard output of a script of bash."""
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=self.folder,
            env=os.environ | {"PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}"} | self.environ,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout


def campaign(job: dict[str, Any]) -> dict[str, Any]:
    grid = {
        "scenes": {"meshes": ["primitive/sphere"], "views": [0.1], "camera": job["scene"]["camera"]},
        "attacks": [{"name": "image", "attack": job["attack"]}],
        "selection": {"right": False},
    }
    return {"name": "small", "grids": [grid | ({"goal": job["goal"]} if "goal" in job else {})]}


def poses() -> dict[str, Any]:
    spec = small("pyrender-zoo")
    spec["scene"] = scene() | {"objects": [{"mesh": "primitive/torus"}]}
    spec["attack"] |= {"groups": ["rotation", "translation"]}
    return spec


def test_every_example_runs(tmp_path: Path, stack: Stack) -> None:
    (tmp_path / "reader").mkdir()
    reader = Reader(tmp_path / "reader")
    alone(reader)
    keys_and_backups(reader)
    reader.environ = {"SCENE_ATTACK_URL": stack_url(stack)}
    jobs(reader, stack)
    campaigns(reader, stack)
    assets(reader)
    assert reader.left == []


def alone(reader: Reader) -> None:
    run = reader.run
    assert "primitive" not in run("scene-attack assets list --search piano")
    run("scene-attack assets list --category Bathroom --licence CC0")
    assert "grand-piano" in run("scene-attack assets show furniture/grand-piano")
    assert "courtyard" in run("scene-attack assets environments")
    assert "Ball" in run("scene-attack scene show room.glb")
    run("scene-attack scene show room.glb --out scene.png")
    assert (reader.folder / "scene.png").is_file()
    assert "efficientnet-lite0" in run("scene-attack targets")
    run("scene-attack targets check efficientnet-lite0")
    run("scene-attack targets check efficientnet-lite0")  # of the group's help, and of the command's
    assert "error" in run("scene-attack plan examples/torch-combined.json")
    run("scene-attack render examples/torch-combined.json --out picture.png")
    assert (reader.folder / "picture.png").is_file()
    assert "torch combined" in run("scene-attack run examples/torch-combined.json --out out/combined")
    run("scene-attack run - --out out/x < spec.json")
    run("scene-attack replay out/combined")
    assert "Subsets" in run("scene-attack analyse out/combined --minimal")
    reader.command("scene-attack run poses.json --out out/poses")
    reader.command("scene-attack run examples/image-fgsm.json --out out/image")
    run("scene-attack analyse out/poses --coordinates --transfer efficientnet-lite0 --second-opinion torch")
    run("scene-attack rerender out/image/attacked.png examples/image-fgsm.json --out rendered.png")
    run("scene-attack export out/combined --out out/combined-export")
    assert (reader.folder / "out/combined-export/scene_after.glb").is_file()
    run("scene-attack campaign run examples/campaign-small.json --out out/small")
    shutil.rmtree(reader.folder / "out/x")
    run("scene-attack campaign run - --out out/x < campaign.json")
    run("scene-attack campaign export out/small --maite out/adversaries")
    assert (reader.folder / "out/adversaries/metadata.json").is_file()


def jobs(reader: Reader, stack: Stack) -> None:
    run = reader.run
    assert "soccer" in run("scene-attack submit examples/image-fgsm.json --watch")
    own = {"http://10.0.0.7:8008": stack_url(stack)}
    found = run("scene-attack submit - --url http://10.0.0.7:8008 < spec.json", **own).split()[0]
    assert stack.ended(found)["state"] == "succeeded"
    of = {ID: found[:8]}
    assert found[:8] in run("scene-attack jobs list")
    run("scene-attack jobs list --state failed --all")
    run("scene-attack jobs list -q 'piano verified p<5e-3' --sort p --limit 500")
    assert json.loads(run(f"scene-attack jobs show {ID} --json", **of))["id"] == found
    run(f"scene-attack jobs watch {ID}", **of)
    run(f"scene-attack jobs cancel {ID}", **of)
    assert "Figure 3 [paper]" in run(f"scene-attack jobs edit {ID} --title 'Figure 3' --tag paper", **of)
    repeated = run(f"scene-attack jobs retry {ID}", **of).strip()
    assert stack.client.get(f"/v1/jobs/{repeated}").json()["retry_of"] == found
    unfinished = stack.submit(ENDLESS)
    until(lambda: saved_step(stack.data / "checkpoints" / unfinished) > 1, "a checkpoint")
    stack.client.post(f"/v1/jobs/{unfinished}/cancel")
    assert stack.ended(unfinished)["state"] == "cancelled"
    later = run(f"scene-attack jobs continue {ID}", **{ID: unfinished}).strip()
    assert stack.client.post(f"/v1/jobs/{later}/cancel").json()["retry_of"] == unfinished
    run(f"scene-attack jobs download {ID} --out out/piano", **of)
    assert (reader.folder / "out/piano/attacked.png").is_file()
    run(f"scene-attack export {ID} --out piano.zip", **of)
    assert (reader.folder / "piano.zip").is_file()
    run(f"scene-attack jobs delete {ID}", **of)
    assert stack.client.get(f"/v1/jobs/{found}").status_code == 404


def campaigns(reader: Reader, stack: Stack) -> None:
    run = reader.run
    run("scene-attack campaign submit examples/campaign-small.json")
    assert "small" in run("scene-attack campaign list")
    found = stack.client.get("/v1/campaigns").json()["items"][0]["id"]
    until(lambda: stack.client.get(f"/v1/campaigns/{found}").json()["state"] == "finished", "the campaign ends")
    of = {ID: found[:8]}
    assert "finished" in run(f"scene-attack campaign show {ID}", **of)
    run(f"scene-attack campaign table {ID}", **of)
    run(f"scene-attack campaign table {ID} --out out/table", **of)
    shutil.rmtree(reader.folder / "out/adversaries")
    run(f"scene-attack campaign export {ID} --maite out/adversaries", **of)
    long_one = stack.client.post("/v1/campaigns", json=campaign(ENDLESS | {"attack": long(5000)["attack"]})).json()
    of = {ID: long_one["id"][:8]}
    assert "paused" in run(f"scene-attack campaign pause {ID}", **of)
    assert "paused" not in run(f"scene-attack campaign resume {ID}", **of)
    assert "cancel" in run(f"scene-attack campaign cancel {ID}", **of)


def assets(reader: Reader) -> None:
    run = reader.run
    name = run("scene-attack assets add chair.obj").strip()
    run("scene-attack assets add models.zip --mesh chair.obj --licence 'CC BY 4.0'")
    run("scene-attack assets add garden.hdr")
    assert "chair" in run("scene-attack assets uploads")
    run("scene-attack assets delete sha256:0f3c…", **{"sha256:0f3c…": name})


def keys_and_backups(reader: Reader) -> None:
    """Of the reader's own data directory: a key would close the service to the tests that share it."""
    run = reader.run
    run("scene-attack keys create alice")
    run("scene-attack keys create ci --owner alice --scope jobs:write --scope jobs:read --days 90")
    run("scene-attack keys create operator --scope admin")
    first = json.loads(reader.command("scene-attack keys list --json"))[0]["prefix"]
    assert first in run("scene-attack keys list")
    assert "revoked" in run("scene-attack keys revoke sa_1f0c9a7b3e", sa_1f0c9a7b3e=first)
    for example in [one for one in reader.left if "backup" in one]:
        own = {"/backups/monday": str(reader.folder / "backups" / str(len(reader.left)))}
        if "/srv" in example:
            own["/srv/scene-attack"] = reader.environ["SCENE_ATTACK_DATA"]
        run(example, **own)


def stack_url(stack: Stack) -> str:
    return str(stack.client.base_url)
