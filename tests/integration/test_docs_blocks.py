"""Every block of Python and shell in the README and in docs/*.md, run as it stands in one reader's folder.

The folder has small files under the names that the pages use, and a service runs beside it. Only the service's address,
ids and the number of steps are the test's own.
"""

import json
import re
import sys
from pathlib import Path

import pytest

from tests.integration.conftest import Stack, until
from tests.integration.specs import QUICK
from tests.integration.test_help_examples import Reader, campaign
from tests.integration.test_run import small

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
PAGES = {page.name: page for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]}
BLOCK = re.compile(r"^```(python|sh|bash)(?: title=\"[^\"]*\")?\n(.*?)^```$", re.M | re.S)
FOOLED = {
    "scene": {"camera": {"size": [224, 224]}},
    "goal": {"truth": "ping-pong ball"},
    "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 20},
}
"""A job of `campaign`, with an adversary for the dataset that the page on campaigns reads."""
LISTED = "it lists commands with ids of many jobs, and is no session; test_help_examples runs each of them"
MACHINE = "it sets up other programs or other machines"
ELSEWHERE = {
    ("tutorial.md", ""): "test_tutorial runs the page in its order, with a mesh and a network of the test's own",
    ("targets.md", ""): "tests/unit/docs/test_targets_page.py runs its files, which need each other; the weights of "
    "IEP are the reader's",
    ("README.md", "scripts/demo"): "it sets up the project; test_demo runs the demonstration",
    ("README.md", "import torch"): "tests/unit/docs/test_targets_page.py runs it, and reads what it found",
    ("index.md", "scene-attack serve"): LISTED,
    ("index.md", "scene-attack campaign run"): LISTED,
    ("index.md", "scene-attack convert"): "tests/unit/blender runs it, where Blender is",
    ("index.md", "scene-attack accuracy"): "minutes of measurements; tests/unit/accuracy runs their parts",
    ("campaigns.md", "scene-attack campaign list"): LISTED,
    (
        "operations.md",
        "scene-attack keys",
    ): "its key closes the service that the other blocks use; test_sign_in has one",
    ("operations.md", ""): MACHINE,
    ("vqa.md", "import json"): "tests/unit/docs/test_vqa_page.py runs it, and attacks its request",
}
"""Blocks that are not run here, by page and the beginning of the block, and why."""


def exception(page: str, text: str) -> tuple[str, str] | None:
    return next((key for key in ELSEWHERE if key[0] == page and text.startswith(key[1])), None)


BLOCKS = [
    pytest.param(language, text, id=f"{page}-{text.splitlines()[0][:40]}")
    for page, path in PAGES.items()
    for language, text in BLOCK.findall(path.read_text("utf-8"))
    if exception(page, text) is None
]


@pytest.fixture(scope="module")
def reader(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A folder in which a job and a campaign were run already, as the pages that go on from them assume."""
    folder = tmp_path_factory.mktemp("reader")
    reader = Reader(folder)
    reader.environ = {"SCENE_ATTACK_URL": str(stack.client.base_url), "SCENE_ATTACK_DATA": str(stack.data)}
    python = folder / "bin/python"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    (folder / ".venv").symlink_to(folder)
    for name in ("vqa-torch", "vqa-pyrender"):
        (folder / f"examples/{name}.json").write_text(json.dumps(small(name)))
    (folder / "examples/campaign-small.json").write_text(json.dumps(campaign(FOOLED)))
    (folder / "chair.mtl").write_text("newmtl wood\nKd 1 0.5 0.2\n")
    (folder / "wood.png").write_bytes((ROOT / "docs/images/combined.png").read_bytes())
    reader.command("scene-attack run examples/torch-combined.json --out out/combined")
    reader.command("scene-attack run examples/image-fgsm.json --out out/image")
    return reader


@pytest.fixture(scope="module")
def job(stack: Stack) -> str:
    return str(stack.ended(stack.submit(QUICK))["id"])


@pytest.fixture(scope="module")
def finished_campaign(stack: Stack) -> str:
    """A campaign of the service."""
    made = str(stack.client.post("/v1/campaigns", json=campaign(QUICK)).json()["id"])
    until(lambda: stack.client.get(f"/v1/campaigns/{made}").json()["state"] == "finished", "the campaign ends")
    return made


@pytest.mark.usefixtures("finished_campaign")
@pytest.mark.parametrize(("language", "text"), BLOCKS)
def test_a_block_runs(language: str, text: str, reader: Reader, stack: Stack, job: str) -> None:
    address = str(stack.client.base_url).removeprefix("http://")
    text = re.sub(r"\b(127\.0\.0\.1|localhost):8008\b", address, text)
    text = re.sub(r"(?<=[ /])ID\b", job, text)
    text = text.replace('"steps": 50', '"steps": 2')
    if language == "python":
        (reader.folder / "block.py").write_text(text)
        text = "python block.py"
    for line in text.splitlines():  # none needs what another has set
        (reader.command if line.startswith("scene-attack ") else reader.shell)(line)


def test_every_exception_is_needed() -> None:
    blocks = [(page, text) for page, path in PAGES.items() for _, text in BLOCK.findall(path.read_text("utf-8"))]
    assert {exception(*block) for block in blocks} - {None} == ELSEWHERE.keys()
