"""What a researcher meets who installs the wheel beside the ordinary build of torch, in a folder of their own."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import scene_attack as sa
from tests.integration.specs import QUICK
from tests.unit.client.command_line import process

pytestmark = pytest.mark.integration
ROOT = Path(__file__).parents[2]
DRAW = """
import scene_attack as sa
sa.renderer(sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh="primitive/sphere")]), "torch")
"""


def run(folder: Path, program: str) -> subprocess.CompletedProcess[str]:
    (folder / "program.py").write_text(program)
    return subprocess.run([sys.executable, "program.py"], cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="torch's build for CPUs has no Triton")
def test_torch_can_optimise_after_a_scene_was_drawn(tmp_path: Path) -> None:
    """An optimiser's first step imports Triton, whose LLVM meets that of Mesa's llvmpipe: a segmentation fault."""
    step = """
import torch
value = torch.zeros(2, requires_grad=True)
optimiser = torch.optim.Adam([value])
value.sum().backward()
optimiser.step()
"""
    done = run(tmp_path, DRAW + step)
    assert done.returncode == 0, (done.returncode, done.stderr[-500:])


def test_triton_is_loaded_before_mesas_llvm(tmp_path: Path) -> None:
    """The same without Triton itself: a stand-in of its name notes whether an LLVM was in the process before it."""
    inner = tmp_path / "triton" / "_C"
    inner.mkdir(parents=True)
    (tmp_path / "triton" / "__init__.py").write_text("from triton._C import libtriton\n__version__ = '3.8.0'\n")
    (inner / "__init__.py").write_text("")
    (inner / "libtriton.py").write_text("LATE = 'libLLVM' in open('/proc/self/maps').read()\n")
    ask = "import triton._C.libtriton as it\nprint(it.LATE, 'libLLVM' in open('/proc/self/maps').read())"
    late, drawn_by_llvm = run(tmp_path, DRAW + ask).stdout.split()
    if drawn_by_llvm == "False":
        pytest.skip("OpenGL draws without LLVM here")
    assert late == "False"


def test_a_source_of_a_plug_in_that_is_left_out_is_explained(tmp_path: Path) -> None:
    spec = ROOT / "examples" / "vqa-torch.json"
    done = process("--without-plugin", "questions", "run", str(spec), "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "scene.source.format: there is no 'clevr'; there are file" in done.stderr
    assert "target.ask: no installed task has this field" in done.stderr


def test_a_frame_tells_columns_of_the_same_method_apart(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    attacks = [{"name": name, "attack": sa.FGSM(renderer="image", steps=n)} for name, n in (("weak", 1), ("strong", 2))]
    scene = sa.Scene.model_validate(QUICK["scene"])
    grid = {"scenes": [scene], "targets": ["efficientnet-lite0"], "attacks": attacks, "selection": {"right": False}}
    frame = sa.campaign({"name": "two", "grids": [grid]}, out=tmp_path / "out").to_frame()
    assert len(frame) == 2
    described = frame.drop(columns=["original", "attacked", "outcome", "verified", "p", "queries", "seconds"])
    assert len(described.drop_duplicates()) == 2, described.to_string()


@pytest.mark.filterwarnings("ignore")
def test_a_script_module_is_refused_by_the_name_of_the_argument() -> None:
    module = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * 8 * 8, 2)).eval()
    traced = torch.jit.trace(module, torch.zeros(2, 3, 8, 8))
    with pytest.raises(sa.InvalidRequest) as refused:
        sa.target(traced, labels=["a", "b"], preprocessing=sa.Preprocessing(input_size=(8, 8)))
    assert refused.value.field == "target"


def test_the_types_accept_what_the_examples_pass(tmp_path: Path) -> None:
    program = """
import torch
import scene_attack as sa
scene = sa.Scene(camera=sa.Camera(size=(64, 64)), objects=[sa.Object(mesh="primitive/cube", color=(0.8, 0.2, 0.1))])
target = sa.target(torch.nn.Flatten(), preprocessing=sa.Preprocessing(input_size=(32, 32), mean=(0.5, 0.5, 0.5)))
target.save("folder")
goal = sa.Goal(truth=["a", "b"])
attacks = [{"name": "image", "attack": sa.FGSM(renderer="image", steps=20)}]
grid = sa.Grid(scenes=[scene], targets=["mine"], attacks=attacks, selection={"right": False}, goal=goal)
campaign = sa.Campaign(grids=[grid])
"""
    (tmp_path / "program.py").write_text(program)
    mypy = [sys.executable, "-m", "mypy", "--no-incremental", "--ignore-missing-imports", "--follow-imports=silent"]
    done = subprocess.run([*mypy, "--config-file=", "program.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
