"""Blender's process: the same bits whatever came before; killed, hanging and out of memory, it is started once more."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from scene_attack.errors import JobFailure
from scene_attack.rendering.pyrender.path_tracer import PathTracer
from scene_attack.scenes.description import Lights, PointLight, Shadows, SpotLight
from scene_attack_blender import process as module
from scene_attack_blender.process import BlenderProcess
from tests.unit.path_tracing.agreement import tracer
from tests.unit.rendering import shapes

pytestmark = pytest.mark.slow


LIGHTS = Lights(points=(PointLight(), PointLight(position=(-1, 1, 1))), spots=(SpotLight(),))


def renderer(size: tuple[int, int] = (24, 32), **settings: int) -> PathTracer:
    """Two spheres that shade each other and pass light on."""
    description = shapes.scene(size, objects=2, lights=LIGHTS).model_copy(update={"shadows": Shadows()})
    spheres = [shapes.mesh(shapes.sphere(radius, 24)) for radius in (0.4, 0.2)]
    return tracer("blender", shapes.placed(description, *spheres), **{"samples": 4, "bounces": 2} | settings)


def places(own: PathTracer, count: int) -> dict[str, torch.Tensor]:
    """Values [count, ...] of all groups, around the scene's own."""
    random = torch.Generator().manual_seed(0)
    return {
        group: value + 0.05 * torch.rand(count, *value.shape, generator=random, dtype=value.dtype)
        for group, value in own.initial().items()
    }


def row(values: dict[str, torch.Tensor], number: int) -> dict[str, torch.Tensor]:
    return {group: value[number : number + 1] for group, value in values.items()}


def test_an_image_does_not_depend_on_what_was_drawn_before_or_beside(process: BlenderProcess) -> None:
    own = renderer()
    values = places(own, 3)
    together = own.render(values)
    assert not torch.equal(together[0], together[1])
    for number in (2, 0, 1, 0):
        assert torch.equal(own.render(row(values, number))[0], together[number])
    process.close()  # the next image is another process's, whose first it is
    assert torch.equal(own.render(row(values, 1))[0], together[1])


@pytest.mark.usefixtures("process")
def test_an_image_does_not_depend_on_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    images = []
    for threads in (1, 2):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        own = renderer()
        images.append(own.trace(own.frame({group: value.numpy() for group, value in own.initial().items()})))
    assert np.array_equal(*images)


@pytest.mark.usefixtures("process")
def test_a_seed_is_another_image_and_samples_are_less_noise() -> None:
    own = renderer()
    values = places(own, 1)
    other = own.reseeded(1)
    spread = (own.render(values) - other.render(values)).square().mean()
    assert spread > 0
    many = (own.exact().render(values) - own.exact().reseeded(1).render(values)).square().mean()
    assert many < spread / 8, "32 times the samples leave less than 1/32 of a variance, as they are stratified"


def test_a_killed_blender_is_started_again_with_the_same_result(process: BlenderProcess) -> None:
    own = renderer()
    values = places(own, 2)
    before = own.render(values)
    first = process.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    assert torch.equal(own.render(values), before)
    assert process.pid != first


def test_no_image_is_left_on_the_disk(process: BlenderProcess, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whoever kills the job's process ends Blender, too, and nobody empties its folder."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    process.close()
    own = renderer()
    own.render(places(own, 2))
    assert list(tmp_path.glob("*/errors"))
    assert not list(tmp_path.rglob("*.exr"))


def test_the_folder_of_a_killed_process_is_removed_by_the_next(
    process: BlenderProcess, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    process.close()
    ended = subprocess.run(["sh", "-c", "echo $$"], capture_output=True, text=True, check=True).stdout.strip()
    left, used = (tmp_path / f"scene-attack-blender-{owner}-x" for owner in (ended, os.getppid()))
    for folder in (left, used):
        folder.mkdir()
        (folder / "errors").touch()
    own = renderer()
    own.render(places(own, 1))
    assert (left.exists(), used.exists()) == (False, True)
    assert len(list(tmp_path.glob(f"scene-attack-blender-{os.getpid()}-*"))) == 1


def test_a_blender_that_hangs_is_ended_and_started_again(
    process: BlenderProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = renderer()
    values = places(own, 1)
    monkeypatch.setattr(module, "STILL_SECONDS", 5.0)
    before = own.render(values)
    first = process.pid
    assert first is not None
    os.kill(first, signal.SIGSTOP)
    assert torch.equal(own.render(values), before)
    assert process.pid != first


def instead(code: str) -> Callable[..., Sequence[str]]:
    """A command that runs code before it is Blender's process."""
    run = "\nimport runpy, sys; sys.argv = sys.argv[1:]; runpy.run_module(sys.argv[0], run_name='__main__')"
    return lambda *command: [sys.executable, "-P", "-c", code + run, *command]


FAILING: dict[str, tuple[str, str, str]] = {
    "killed": ("import os; os.kill(os.getpid(), 9)", "internal", "was ended by the signal SIGKILL, as the system does"),
    "hanging": ("import os; os.kill(os.getpid(), 19)", "timeout", "did nothing for 1 seconds, and was ended"),
    "crashed": ("import os; os.abort()", "internal", "was ended by the signal SIGABRT$"),
    "broken": ("import sys; sys.modules['bpy'] = None", "internal", "ended with code 1: ModuleNotFoundError"),
    "out of memory": (
        # more than Blender's libraries take and less than the scene does
        "import resource; resource.setrlimit(resource.RLIMIT_DATA, (400 << 20, 400 << 20))",
        "out-of-memory",
        "ran out of memory",
    ),
}


@pytest.mark.parametrize("why", FAILING)
def test_a_blender_that_fails_twice_ends_the_job_with_a_reason(
    process: BlenderProcess, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    code, kind, words = FAILING[why]
    started: list[Any] = []
    command = instead(code)
    monkeypatch.setattr(module, "STILL_SECONDS", 1.0 if why == "hanging" else 60.0)
    monkeypatch.setattr(module, "program", lambda *given: started.append(given) or command(*given))
    with pytest.raises(JobFailure, match=words) as failed:
        renderer((1536, 1536)).render({})
    assert failed.value.kind == kind
    assert len(started) == 2
    assert process.pid is None
    monkeypatch.undo()
    assert renderer().render({}).shape == (1, 24, 32, 3), "the next job has a Blender again"
