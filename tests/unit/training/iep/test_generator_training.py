from pathlib import Path

import pytest
import torch

from scene_attack_questions.iep.program_generator import ProgramGenerator
from tests.unit.training.iep.conftest import Data
from training.iep.generator_training import generator_step, right_programs
from training.loop import Schedule, TrainingLoop

pytestmark = pytest.mark.slow


@pytest.mark.usefixtures("one_thread")
def test_the_generator_learns_the_programs_of_questions(simple: tuple[Data, Data], tmp_path: Path) -> None:
    training, test = simple
    torch.manual_seed(0)
    generator = ProgramGenerator()
    assert sum(right_programs(generator, test.examples[:50])) <= 5
    step = generator_step(generator, training.examples, 32)
    schedule = Schedule(120, 5e-3)
    loop = TrainingLoop(generator, tmp_path / "generator", {}, (0,), schedule.decay, schedule.clip)
    loop.run(schedule.progress, schedule.rate_at, step, lambda _: None)
    right = right_programs(generator, test.examples)
    assert sum(right) / len(right) > 0.9
