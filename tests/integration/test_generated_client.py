"""A client that openapi-python-client generates from openapi.yaml, and the examples in it, against the real stack."""

import json
import os
import re
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import pytest
import yaml

from scene_attack_service.settings import Settings
from tests.integration.conftest import Stack

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
REQUIREMENTS = Path(__file__).with_name("client_generator.txt")
PROGRAM = Path(__file__).with_name("generated_client_job.py")
EXAMPLES = ROOT / "api" / "scene_attack_api" / "examples.json"


@pytest.fixture(scope="module")
def generator() -> Path:
    """The Python of a virtual environment with the generator, which is kept in the cache for the next run."""
    made_of = sha256(REQUIREMENTS.read_bytes() + sys.version.encode()).hexdigest()[:16]
    folder = Settings().cache_dir / "client-generator" / made_of
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(mkdtemp(dir=folder.parent))
        try:
            subprocess.run([sys.executable, "-m", "venv", part], check=True)
            pip = [part / "bin" / "python", "-m", "pip", "install", "--disable-pip-version-check", "-q"]
            subprocess.run([*pip, "--require-hashes", "--no-deps", "-r", REQUIREMENTS], check=True)
            part.rename(folder)
        finally:
            rmtree(part, ignore_errors=True)
    return folder / "bin" / "python"


def test_a_generated_client_runs_a_job(stack: Stack, generator: Path, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("post_hooks: []")  # they would format the code
    command = [generator, "-m", "openapi_python_client", "generate", "--path", ROOT / "openapi.yaml", "--meta", "none"]
    made = subprocess.run(
        [*command, "--output-path", tmp_path / "generated", "--config", tmp_path / "config.yaml"],
        capture_output=True,
        text=True,
        check=True,
    )
    described = yaml.safe_load((ROOT / "openapi.yaml").read_text())["paths"]
    operations = [one for methods in described.values() for one in methods.values()]

    # It knows no zip files, glTF and PNG images, and leaves out no other answer and no operation.
    left_out = re.findall(r"WARNING parsing (\w+ \S+) within", made.stdout + made.stderr)
    binary = ["/v1/jobs/{job_id}/export", "/v1/jobs/{job_id}/scene.glb", "/v1/assets/{sha256}/thumbnail"]
    assert left_out == [f"GET {path}" for path in binary], made.stdout
    functions = {(path.parent.name, path.stem) for path in (tmp_path / "generated" / "api").glob("*/[a-z]*.py")}
    assert functions == {(one["tags"][0], one["operationId"]) for one in operations}

    client = os.environ | {"PYTHONPATH": str(tmp_path)}
    run = subprocess.run(
        [generator, PROGRAM, str(stack.client.base_url), EXAMPLES], env=client, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == {
        "state": "succeeded",
        "outcome": "fooled",
        "after": "folding chair",
        "image complete": True,
        "again": True,
        "problem": [422, "scene.objects.0.mesh"],
    }


def test_the_service_accepts_the_requests_of_the_examples(stack: Stack) -> None:
    requests = {name: one["request"] for name, one in json.loads(EXAMPLES.read_text()).items() if "request" in one}
    paths = yaml.safe_load((ROOT / "openapi.yaml").read_text())["paths"]
    routes = {one["operationId"]: (method, path) for path, methods in paths.items() for method, one in methods.items()}
    job = stack.ended(stack.submit(requests["submit_job"]))
    requests["rerender_image"]["image"]["job"] = job["id"]
    for name, request in requests.items():
        method, path = routes[name]
        answer = stack.client.request(method, path.replace("{job_id}", job["id"]), json=request)
        assert answer.is_success, f"{name}: {answer.text}"
