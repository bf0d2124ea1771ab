from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

from scene_attack_questions.iep.engine import Engine
from tests.unit.training.iep.conftest import Data
from training.iep.engine_training import EVERYTHING_FROM, Draw, chances, engine_step, execute
from training.iep.export import answers, by_family
from training.loop import Schedule, TrainingLoop

pytestmark = pytest.mark.slow


@pytest.mark.usefixtures("one_thread")
def test_the_engine_learns_to_filter_count_and_see(simple: tuple[Data, Data], tmp_path: Path) -> None:
    """The most frequent answer is right in about half of these questions; the steps take ten seconds of one core."""
    training, test = simple
    torch.manual_seed(0)
    engine = Engine()
    step = engine_step(engine, training.features, training.examples, training.cells, batch=48)
    schedule = Schedule(160, 4e-3)
    loop = TrainingLoop(engine, tmp_path / "engine", {}, (0,), schedule.decay, schedule.clip)
    loop.run(schedule.progress, schedule.rate_at, step, lambda _: None)
    right = [found == one.answer for found, one in zip(_answers(engine, test), test.examples, strict=True)]
    shares = by_family(test.examples, right)
    assert shares["exist"].share > 0.85
    assert shares["count"].share > 0.75
    most = Counter(one.answer for one in test.examples if one.family == "count").most_common(1)[0][1]
    assert most / shares["count"].of < 0.6


def _answers(engine: Engine, data: Data) -> list[str]:
    return answers(engine, data.features, data.examples)


def test_features_of_half_precision_of_all_images_are_taken_by_their_index(mixed: Data) -> None:
    torch.manual_seed(0)
    engine = Engine().eval()
    some = mixed.examples[100:120]
    with torch.no_grad():
        scores = execute(engine, mixed.features.half(), some).scores
        for number, example in enumerate(some):
            alone = execute(engine, mixed.features.half()[: example.image + 1], [example]).scores[0]
            assert torch.allclose(scores[number], alone, atol=1e-4)


def test_rare_functions_are_drawn_more_often_than_they_are_asked_about(mixed: Data) -> None:
    drawn = chances(mixed.examples)
    assert abs(drawn.sum() - 1) < 1e-12
    counts = Counter(node.label for one in mixed.examples for node in {n.label: n for n in one.program.nodes}.values())
    rare = min(counts, key=counts.__getitem__)
    has = np.array([any(node.label == rare for node in one.program.nodes) for one in mixed.examples])
    assert drawn[has].sum() > 1.5 * has.mean()


def test_short_programs_come_first_and_no_question_twice(mixed: Data) -> None:
    draw = Draw(mixed.examples, batch=32)
    lengths = np.array([len(one.program.nodes) for one in mixed.examples])
    seen = {progress: set[int]() for progress in (0.0, 0.1, EVERYTHING_FROM)}
    for progress, every in seen.items():
        for seed in range(40):
            chosen = draw(progress, np.random.default_rng([1, seed]))
            assert len(chosen) == len(set(chosen))
            assert 8 <= len(chosen) <= 32
            assert lengths[chosen].max() <= draw.longest(progress)
            every |= set(chosen)
    assert lengths[list(seen[0.0])].max() <= 8 < lengths[list(seen[0.1])].max() < lengths.max()
    assert lengths[list(seen[EVERYTHING_FROM])].max() == lengths.max()


def test_a_batch_asks_several_questions_about_an_image(mixed: Data) -> None:
    chosen = Draw(mixed.examples, batch=32, per_image=4)(0.5, np.random.default_rng(0))
    images = {mixed.examples[one].image for one in chosen}
    assert len(chosen) == 32
    assert len(images) <= 8
    assert chosen == Draw(mixed.examples, batch=32, per_image=4)(0.5, np.random.default_rng(0))
