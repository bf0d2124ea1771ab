from math import exp, log

import pytest
import torch

from scene_attack_questions.iep.assembly import Question, assemble
from scene_attack_questions.iep.engine import Engine
from scene_attack_questions.program import Node, Program
from training.iep.engine_training import engine_loss, mask_loss, occupancy
from training.iep.examples import Example

ANSWERS = ("yes", "no", *map(str, range(11)))
FEWER = Program(
    (
        Node("scene", (), ()),
        Node("filter_color", (0,), ("red",)),
        Node("count", (1,), ()),
        Node("scene", (), ()),
        Node("count", (3,), ()),
        Node("less_than", (2, 4), ()),
    )
)
RED_LEFT = Program(
    (
        Node("scene", (), ()),
        Node("filter_color", (0,), ("red",)),
        Node("unique", (1,), ()),
        Node("relate", (2,), ("left",)),
        Node("exist", (3,), ()),
    )
)


def cross_entropy(logit: float, truth: float) -> float:
    probability = 1 / (1 + exp(-logit))
    return -4 * truth * log(probability) - (1 - truth) * log(1 - probability)


def test_the_loss_of_masks_weighs_cells_with_objects_four_times() -> None:
    logits = torch.tensor([[0.3, -1.2, 2.0], [0.0, 1.0, -2.0]])
    truth = [[0, 0, 1], [1, 0, 0]]
    by_hand = [cross_entropy(float(logits[i, j]), truth[i][j]) for i in range(2) for j in range(3)]
    assert float(mask_loss(logits, torch.tensor(truth).float())) == pytest.approx(sum(by_hand) / 6, rel=1e-6)


def test_occupancy_marks_the_cells_of_each_row() -> None:
    made = occupancy([[3], [], [299, 0]], torch.zeros(()))
    assert made.shape == (3, 300)
    assert made.nonzero().tolist() == [[0, 3], [2, 0], [2, 299]]


def test_each_part_is_that_of_its_nodes() -> None:
    torch.manual_seed(2)
    engine = Engine(40).double()
    features = torch.randn(2, 96, 15, 20, dtype=torch.float64)
    cells = [[5, 17, 200], [44, 3]]
    examples = [
        Example(0, "", FEWER, ((0, 1, 2), (1,), "1", (0, 1, 2), "3", "yes"), "integer"),
        Example(1, "", RED_LEFT, ((0, 1), (1,), (1,), (0,), "yes"), "relate"),
    ]
    engine.requires_grad_(False)
    execution = engine(features, assemble([Question(example.program, example.image) for example in examples]))
    loss = engine_loss(execution, examples, cells)

    def wrong(scores: torch.Tensor, word: str) -> float:
        return float(scores.logsumexp(0) - scores[ANSWERS.index(word)])

    def masked(question: int, node: int, objects: list[int]) -> list[float]:
        slot = execution.assembly.slots[question][node]
        own = execution.candidates.cells[slot.image].tolist()
        logits = execution.mask_logits([slot])[0].tolist()
        return [cross_entropy(logit, float(cell in objects)) for logit, cell in zip(logits, own, strict=True)]

    answers = [wrong(execution.scores[number], "yes") for number in range(2)]
    slots = execution.assembly.slots[0]
    inner = [wrong(execution.answer_scores([slots[node]])[0], word) for node, word in ((2, "1"), (4, "3"))]
    modules = [*masked(0, 1, [17]), *masked(1, 1, [3]), *masked(1, 3, [44])]
    scenes = [
        cross_entropy(float(execution.candidates.scene[image, cell]), float(cell in cells[image]))
        for image in range(2)
        for cell in range(300)
    ]
    masks = sum(scenes) / 600 + sum(modules) / len(modules)
    assert float(loss.answers) == pytest.approx(sum(answers) / 2, rel=1e-9)
    assert float(loss.inner) == pytest.approx(sum(inner) / 2, rel=1e-9)
    assert float(loss.masks) == pytest.approx(masks, rel=1e-9)
    assert float(loss.total) == pytest.approx(sum(answers) / 2 + 0.5 * masks + 0.5 * sum(inner) / 2, rel=1e-9)
