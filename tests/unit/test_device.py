"""The device of the setting: networks and the torch renderer compute there, attacks remember on the CPU."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from math import isfinite
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from scene_attack.attacks.problem import generator
from scene_attack.cli.app import app
from scene_attack.errors import InvalidRequest
from scene_attack.export.bundle import into_folder, write_bundle
from scene_attack.process import check_device, describe, device, replaced
from scene_attack.rendering.factory import build
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import KEPT_SCENES
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack.targets import registry
from scene_attack_service.settings import Settings
from tests.card import card

pytestmark = [
    pytest.mark.slow,
    # On CUDA: the second, as docs/operations.md says.
    pytest.mark.filterwarnings("ignore:Attempting to run cuBLAS, but there was no current CUDA context:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*does not have a deterministic implementation:UserWarning"),
]


@pytest.fixture(params=["cpu", "cuda:0"])
def chosen(request: pytest.FixtureRequest) -> Iterator[str]:
    """A device, chosen by the setting. A machine without CUDA pretends to have it."""
    forget()
    pretended = request.param != "cpu" and not torch.cuda.is_available()
    with card() if pretended else nullcontext(), replaced(device=request.param):
        yield request.param
    forget()


def forget() -> None:
    """Forgets what a process, whose device never changes, keeps on it."""
    registry.load.cache_clear()
    KEPT_SCENES.clear()


@pytest.mark.parametrize("name", ["cuda:99", *([] if torch.cuda.is_available() else ["cuda", "cuda:0"])])
def test_a_device_that_is_not_there_is_named(name: str) -> None:
    refused = f"SCENE_ATTACK_DEVICE={name}: .*CUDA device.*; use auto or cpu"
    with replaced(device=name), pytest.raises(InvalidRequest, match=refused):
        check_device()


@pytest.mark.parametrize(
    "command",
    ["run examples/image-fgsm.json --out out", "plan examples/image-fgsm.json", "replay out", "serve", "worker", "api",
     "demo", "accuracy stability", "accuracy work-precision"],
)  # fmt: skip
def test_every_command_that_computes_refuses_it(command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Before it writes or starts anything. `scene_attack.cli.app.main` makes exit code 2 of it."""
    monkeypatch.setenv("SCENE_ATTACK_DEVICE", "cuda:99")
    monkeypatch.setenv("SCENE_ATTACK_DATA", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    with replaced(device="cuda:99"):  # what a process of its own would be told by the variable
        done = CliRunner().invoke(app, command.split())
    assert isinstance(done.exception, InvalidRequest), done.output
    assert done.exception.field == "SCENE_ATTACK_DEVICE=cuda:99"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("module", ["scene_attack_worker.job_process", "benchmarks.attack_bounds", "training.training"])
def test_torch_is_loaded_after_the_setting_that_keeps_its_threads_from_spinning(module: str) -> None:
    """`scene_attack` makes it. With two threads on a core that something else uses, an attack took 20 times as long."""
    program = f"import sys, {module}; print(*(name for name in sys.modules if name in ('scene_attack', 'torch')))"
    environment = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split()[0] == "scene_attack"


def test_auto_is_a_device_that_is_there() -> None:
    with replaced(device="auto"):
        check_device()
        assert describe(device()).startswith("cuda:0 (" if torch.cuda.is_available() else "cpu")


def test_the_network_answers_alike_on_every_device(chosen: str) -> None:
    target = registry.load("efficientnet-lite0")
    images = torch.rand(1, 224, 224, 3, generator=torch.Generator().manual_seed(0), requires_grad=True)
    logits = target.logits(images)
    assert logits.device == images.device
    assert f" {chosen}" in target.backend
    [gradient] = torch.autograd.grad(logits[0, 3], images)
    exact = registry.load("efficientnet-lite0", torch.float64).logits(images.detach())
    torch.testing.assert_close(logits.detach().double(), exact.cpu(), rtol=0, atol=2e-4)  # as in float64 on the CPU
    assert bool(gradient.any())


SCENE = {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [48, 48]}}


def test_images_are_made_on_the_device_and_parameters_stay_on_the_cpu(chosen: str, tmp_path: Path) -> None:
    scene = resolve(parse({"scene": SCENE}).scene, Library(Settings().cache_dir, tmp_path))
    for name in ("torch", "image"):
        renderer = build(scene, name)
        assert all(value.device.type == "cpu" for value in renderer.initial().values())
        leaves = {
            group: value[None].requires_grad_()
            for group, value in renderer.initial().items()
            if group in renderer.plan.groups
        }
        images = renderer.render(leaves)
        assert images.device == torch.device(chosen)
        assert f" {chosen}" in renderer.exact().backend
        gradients = torch.autograd.grad(images.sum(), list(leaves.values()))
        assert all(gradient.device.type == "cpu" for gradient in gradients)


@pytest.mark.parametrize("method", [{"method": "fgsm"}, {"method": "zoo", "coordinates": 4}], ids=["fgsm", "zoo"])
@pytest.mark.parametrize("renderer", ["torch", "image"])
def test_a_job_runs_on_every_device(chosen: str, method: dict[str, object], renderer: str, tmp_path: Path) -> None:
    attack = {"renderer": renderer, "steps": 2, **method}
    result = execute(
        parse({"scene": SCENE, "attack": attack}), tmp_path / "out", Library(Settings().cache_dir, tmp_path)
    )
    assert result.provenance.backend.count(f" {chosen}") == 2  # the renderer's and the network's
    assert len(result.trace) > 0


GROUPS = [
    ["normals", "illumination", "material"],
    ["illumination_rgb", "bump", "dials"],
    ["paint", "lamp", "shape"],
    ["translation", "rotation", "camera"],
]
MORE: dict[str, dict[str, object]] = {
    "normals": {"analysis": {"minimal": {}, "interpretation": {"steps": 1}, "rerendering": {"steps": 1}}},
    "paint": {"attack": {"expectation": {"azimuth": 5, "sensor": {}, "samples": 1, "checks": 2}}},
}
"""What a job also asks for, by its first group."""


@pytest.mark.parametrize("groups", GROUPS, ids="+".join)
def test_every_group_is_attacked_analysed_and_exported_on_every_device(
    chosen: str, groups: list[str], tmp_path: Path
) -> None:
    scene = SCENE | {"camera": {"size": [24, 24]}, "lights": {"environment": {"size": [8, 16]}}, "shadows": {}}
    more = MORE.get(groups[0], {})
    attack = {"renderer": "torch", "groups": groups, "method": "fgsm", "steps": 1, **more.get("attack", {})}
    library, out = Library(Settings().cache_dir, tmp_path), tmp_path / "out"
    result = execute(parse({"scene": scene, "attack": attack, "analysis": more.get("analysis", {})}), out, library)
    assert result.provenance.backend.count(f" {chosen}") == 2
    assert {change.group for change in result.change.things} == set(groups)
    write_bundle({file.name: file.read_bytes for file in out.iterdir()}, library, into_folder(tmp_path / "export"))
    assert (tmp_path / "export" / "scene_after.glb").exists()


def test_the_groups_are_all_that_the_torch_renderer_has() -> None:
    assert sorted(group for groups in GROUPS for group in groups) == sorted(TORCH.group_names)


@pytest.mark.parametrize("method", ["fgsm", "zoo"])
@pytest.mark.parametrize("renderer", ["torch", "image"])
def test_a_job_without_kernels_reads_no_memory_that_was_never_written(
    method: str, renderer: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As on CUDA: there are no kernels, and with deterministic algorithms torch fills new memory with NaN."""
    scene = SCENE | {"camera": {"size": [64, 64]}, "lights": {"environment": {"size": [8, 16]}}}
    attack = {"renderer": renderer, "method": method, "steps": 1} | ({"coordinates": 4} if method == "zoo" else {})
    monkeypatch.setattr(compiled, "library", lambda: None)
    torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        assert bool(torch.empty(3).isnan().all())
        spec = parse({"scene": scene, "attack": attack, "tolerance": 2e-2})  # at which a table is looked up
        result = execute(spec, tmp_path / "out", Library(Settings().cache_dir, tmp_path))
    finally:
        torch.use_deterministic_algorithms(False)
    assert all(isfinite(row.advantage) and isfinite(row.distance) for row in result.trace)
    assert isfinite(result.measured.image_error)
    assert result.trace[-1].distance > 0


def test_random_numbers_come_from_the_cpu() -> None:
    assert generator(0, "zoo", 1).device.type == "cpu"
