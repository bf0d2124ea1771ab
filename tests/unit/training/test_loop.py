from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from scene_attack.errors import InvalidRequest
from training.loop import Report, Schedule, TrainingLoop

SCHEDULE = Schedule(steps=60, rate=0.05, decay=0.01)


def a_training(path: Path, seed: int = 4) -> TrainingLoop:
    """A linear map."""
    torch.manual_seed(1)
    return TrainingLoop(nn.Linear(5, 1), path, {"seed": seed}, (seed,), SCHEDULE.decay, SCHEDULE.clip)


def run(loop: TrainingLoop, schedule: Schedule = SCHEDULE, said=lambda _: None, **named) -> None:
    """Learns a sum from values that are drawn anew in each step."""

    def step(progress: float, random: np.random.Generator) -> tuple[Tensor, dict[str, float]]:
        assert 0 <= progress < 1
        x = torch.from_numpy(random.standard_normal((16, 5))).float()
        loss = (loop.module(x)[:, 0] - x.sum(1)).square().mean()
        return loss, {"square": float(loss.detach())}

    loop.run(schedule.progress, schedule.rate_at, step, said, **named)


def test_a_resumed_training_ends_in_the_same_bits(tmp_path: Path) -> None:
    whole, broken = a_training(tmp_path / "whole"), a_training(tmp_path / "broken")
    run(whole)
    run(broken, stop=lambda step: step == 23)
    broken.save()
    run(broken, stop=lambda step: step == 31)  # these steps are lost
    resumed = a_training(tmp_path / "broken")
    assert resumed.step == 23
    run(resumed)
    for one, other in zip(whole.module.parameters(), resumed.module.parameters(), strict=True):
        assert torch.equal(one, other)
    assert (whole.module.weight - 1).abs().max() < 0.5 < (a_training(tmp_path / "none").module.weight - 1).abs().max()


def test_a_finished_training_takes_no_more_steps(tmp_path: Path) -> None:
    run(a_training(tmp_path / "whole"))
    again = a_training(tmp_path / "whole")
    before = again.module.weight.clone()
    run(again)
    assert torch.equal(again.module.weight, before)


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    a_training(tmp_path / "one").save()
    with pytest.raises(InvalidRequest, match="move it away"):
        a_training(tmp_path / "one", seed=5)


def test_reports_are_means_over_the_steps_between_them(tmp_path: Path) -> None:
    reports: list[Report] = []
    run(a_training(tmp_path / "one"), Schedule(steps=120, rate=0.05), reports.append)
    assert [(report.step, report.progress) for report in reports] == [
        (step, (step - 1) / 120) for step in range(20, 121, 20)
    ]
    assert reports[-1].losses["square"] < 0.1 * reports[0].losses["square"]


def test_the_rate_rises_and_falls_to_zero() -> None:
    schedule = Schedule(steps=200, rate=2e-3, warm_up=0.1)
    rates = [schedule.rate_at(step, 0.0) for step in range(200)]
    assert rates[:21] == sorted(rates[:21])
    assert rates[20:] == sorted(rates[20:], reverse=True)
    assert rates[20] == pytest.approx(2e-3)
    assert rates[110] == pytest.approx(1e-3)
    assert 0 < rates[0] < 2e-4
    assert 0 < rates[-1] < 1e-6
