"""A job through Blender: its verdict under other seeds, and the same result where Blender or the job was killed."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scene_attack.attacks import run as loop
from scene_attack.attacks.run import SEEDS
from scene_attack.errors import Cancelled
from scene_attack.runs.execute import Progress, execute
from scene_attack.runs.result import Result
from scene_attack_blender.process import BlenderProcess
from tests.unit.jobs.small import LIBRARY, spec

pytestmark = pytest.mark.slow

ATTACK = {
    "renderer": "blender",
    "groups": ["illumination", "color"],
    "method": "zoo",
    "steps": 3,
    "delta": 0.01,
    "renderer_settings": {"samples": 4, "verify_samples": 8},
}


def run(out: Path, progress: Callable[[Progress], None] = lambda _: None, **options: Any) -> Result:
    return execute(spec(ATTACK), out, LIBRARY, progress=progress, **options)


def same(one: Result, other: Result) -> bool:
    """Whether two results are the same but for run times."""
    first, second = (
        result.model_dump(exclude={"cost": {"seconds"}, "trace": {"__all__": {"seconds"}}}) for result in (one, other)
    )
    return first == second


def test_a_job_ends_in_the_same_result_whatever_was_killed(
    process: BlenderProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undisturbed = run(tmp_path / "one")
    assert undisturbed.spec["attack"]["renderer_settings"] == {  # type: ignore[index]
        "samples": 4,
        "verify_samples": 8,
        "bounces": 4,
        "seed": 0,
    }
    assert undisturbed.verdict.noise is not None
    assert undisturbed.verdict.noise.seeds == SEEDS
    assert undisturbed.verdict.noise.standard_error > 0
    assert undisturbed.measured.image_error > 0
    assert "Cycles of Blender 5.0" in undisturbed.provenance.backend
    assert any(thing.subject == "lamp" for thing in undisturbed.change.things)

    def kill(progress: Progress) -> None:
        if progress.phase == "attacking" and progress.step == 1:
            assert process.pid is not None
            os.kill(process.pid, signal.SIGKILL)

    assert same(run(tmp_path / "killed", kill), undisturbed)

    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0.0)
    checkpoint, reached = tmp_path / "checkpoint", list[int]()
    with pytest.raises(Cancelled):
        run(
            tmp_path / "two",
            lambda progress: reached.append(progress.step if progress.phase == "attacking" else 0),
            cancelled=lambda: max(reached, default=0) >= 2,
            checkpoint=checkpoint,
        )
    assert loop.saved_step(checkpoint) == 2
    process.close()
    resumed: list[int] = []
    result = run(
        tmp_path / "two",
        lambda progress: resumed.append(progress.step) if progress.phase == "attacking" else None,
        checkpoint=checkpoint,
    )
    assert resumed[0] == 2
    assert result.attacked == undisturbed.attacked
    for name in ("perturbation.safetensors", "attacked.png"):
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
