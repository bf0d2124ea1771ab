"""The examples of docs/targets.md, taken out of the page and run; and its tables."""

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
import torch

from scene_attack import plugins
from scene_attack.plugins import load
from scene_attack.runs.set_up import register_folders
from scene_attack.targets import registry
from scene_attack.targets.architectures import ARCHITECTURES
from scene_attack.targets.custom.card import AllowList, Card, Preprocessing
from scene_attack_service.settings import Settings
from tests.installed import installed
from tests.unit.targets.custom.registries import restored

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "targets.md").read_text("utf-8")
BLOCKS = dict(re.findall(r'^```python title="(\w+\.py)"\n(.*?)^```$', PAGE, re.M | re.S))
WRITERS = ["exported.py", "onnx_model.py", "weights.py", "factory.py", "maite_model.py", "endpoint.py"]
TARGET_NAMES = ["endpoint", "exported", "factory", "maite", "onnx", "weights"]


@pytest.fixture(scope="module")
def server() -> Iterator[HTTPServer]:
    """A server on a free port; `registered` gives it the page's handler."""
    with HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def at(server: HTTPServer, text: str) -> str:
    """A text of the page with the server's port instead of the page's."""
    return text.replace("127.0.0.1:8900", f"127.0.0.1:{server.server_address[1]}")


@pytest.fixture(scope="module")
def folder(server: HTTPServer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the page's files, in which those that write a folder were run."""
    made = tmp_path_factory.mktemp("page")
    for name, code in BLOCKS.items():
        (made / name).write_text(at(server, code))
    runs = "import runpy; " + "; ".join(f"runpy.run_path({name!r}, run_name='__main__')" for name in WRITERS)
    environ = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, ''); {runs}"],
        cwd=made, env=environ, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return made


@pytest.fixture
def registered(folder: Path, server: HTTPServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The page's folders as targets, its plug-in and its server."""
    with restored(monkeypatch):
        exported = re.findall(r"^export SCENE_ATTACK_(TARGET_\w+)=(.*)$", PAGE, re.M)
        listed = Settings.model_validate({name.lower(): at(server, value) for name, value in exported})
        monkeypatch.syspath_prepend(folder)
        names: dict[str, type[BaseHTTPRequestHandler]] = {}
        exec(compile(BLOCKS["serve.py"], "serve.py", "exec"), names)
        server.RequestHandlerClass = names["Handler"]
        monkeypatch.syspath_prepend(installed(folder / "plugins", {"architecture": BLOCKS["architecture.py"]}))
        monkeypatch.setattr(plugins, "_loaded", [])
        (plugin,) = [one for one in load((ARCHITECTURES,)) if not one.ours]
        assert plugin.error is None
        folders = register_folders(folder / "mine", AllowList.of(listed))
        assert {one.name: one.error for one in folders} == dict.fromkeys(TARGET_NAMES)
        yield
    for name in ("small", "maite_model", "architecture"):
        sys.modules.pop(name, None)


@pytest.mark.usefixtures("registered")
def test_every_folder_of_the_page_gives_the_same_answers() -> None:
    images = torch.rand(3, 32, 32, 3, generator=torch.Generator().manual_seed(1))
    images = (images * 255).round() / 255  # the server sees 8 bits
    wanted = registry.load("factory").logits(images).log_softmax(dim=1)
    for name in TARGET_NAMES:
        found = registry.load(name).logits(images).log_softmax(dim=1)
        torch.testing.assert_close(found, wanted, rtol=0, atol=1e-4, msg=name)
    assert [name for name in TARGET_NAMES if not registry.has_gradient(name)] == ["endpoint", "onnx"]


def test_the_ten_lines_find_an_adversary(folder: Path) -> None:
    assert len(BLOCKS["ten_lines.py"].splitlines()) == 10
    assert BLOCKS["ten_lines.py"] in (ROOT / "README.md").read_text("utf-8")
    environ = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "ten_lines.py"], cwd=folder, env=environ, capture_output=True, text=True, check=False
    )
    assert re.match(r"([a-e]) → (?!\1)[a-e], verified, p = 0\.\d+\nsurface of sphere: dented by ", done.stdout), (
        done.stdout + done.stderr
    )


def test_the_page_has_every_field_as_it_is_described() -> None:
    for model in (Card, Preprocessing):
        for name, field in model.model_fields.items():
            assert f"| `{name}` | {field.description} |" in PAGE
