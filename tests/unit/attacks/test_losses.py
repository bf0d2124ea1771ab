"""The losses against their formulas written out with sorted lists, and the goals that they refuse."""

import pytest
import torch

from services.attacks.goal import ResolvedGoal, check_loss, loss
from services.attacks.request import LOSSES
from services.errors import InvalidRequest

LOGITS = torch.randn(20, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 4


def dlr(scores: list[float], label: int) -> float:
    """Croce & Hein 2020, equation 5, times −1: what the defender wants, and the attack lowers."""
    falling = sorted(scores, reverse=True)
    other = max(score for k, score in enumerate(scores) if k != label)
    return (scores[label] - other) / (falling[0] - falling[2])


def targeted_dlr(scores: list[float], target: int) -> float:
    falling = sorted(scores, reverse=True)
    other = max(score for k, score in enumerate(scores) if k != target)
    return (other - scores[target]) / (falling[0] - (falling[2] + falling[3]) / 2)


@pytest.mark.parametrize("label", [0, 3])
def test_each_loss_is_its_formula(label: int) -> None:
    leave, reach = ResolvedGoal((label,), None), ResolvedGoal((), label)
    for scores, row in zip(LOGITS.tolist(), LOGITS, strict=True):
        margin = scores[label] - max(score for k, score in enumerate(scores) if k != label)
        assert float(loss("margin", leave, row)) == pytest.approx(margin)
        assert float(loss("margin", reach, row)) == pytest.approx(-margin)
        assert float(loss("dlr", leave, row)) == pytest.approx(dlr(scores, label))
        assert float(loss("dlr", reach, row)) == pytest.approx(targeted_dlr(scores, label))
        p = torch.softmax(row, 0)[label]
        assert float(loss("log-odds", leave, row)) == pytest.approx(float(torch.log(p / (1 - p))))


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("goal", [ResolvedGoal((1,), None), ResolvedGoal((0, 3), None), ResolvedGoal((), 4)])
def test_a_batch_gives_what_each_image_gives(name: str, goal: ResolvedGoal) -> None:
    alone = torch.stack([loss(name, goal, row) for row in LOGITS])  # type: ignore[arg-type]
    torch.testing.assert_close(loss(name, goal, LOGITS), alone)  # type: ignore[arg-type]


def test_only_dlr_does_not_change_with_the_scale_of_the_scores() -> None:
    goal = ResolvedGoal((2,), None)
    torch.testing.assert_close(loss("dlr", goal, 7 * LOGITS + 3), loss("dlr", goal, LOGITS))
    assert not torch.allclose(loss("margin", goal, 7 * LOGITS), loss("margin", goal, LOGITS))


@pytest.mark.parametrize("name", LOSSES)
def test_equal_scores_have_a_finite_loss_and_gradient(name: str) -> None:
    scores = torch.zeros(5, dtype=torch.float64, requires_grad=True)
    value = loss(name, ResolvedGoal((0,), None), scores)  # type: ignore[arg-type]
    value.backward()  # type: ignore[no-untyped-call]
    assert bool(value.isfinite())
    assert scores.grad is not None
    assert bool(scores.grad.isfinite().all())


def test_labels_to_leave_together_are_one_class() -> None:
    """The largest of them stands for the set, in the margin and among the sorted scores."""
    leave = ResolvedGoal((1, 4), None)
    for scores, row in zip(LOGITS.tolist(), LOGITS, strict=True):
        merged = [max(scores[1], scores[4]), scores[0], scores[2], scores[3], scores[5]]
        assert float(loss("dlr", leave, row)) == pytest.approx(dlr(merged, 0))
        assert float(loss("margin", leave, row)) == pytest.approx(merged[0] - max(merged[1:]))


@pytest.mark.parametrize(
    ("goal", "least", "classes"),
    [(ResolvedGoal((0,), None), 3, 3), (ResolvedGoal((0, 2), None), 3, 4), (ResolvedGoal((), 1), 4, 4)],
)
def test_dlr_is_refused_for_fewer_classes_than_it_sorts(goal: ResolvedGoal, least: int, classes: int) -> None:
    check_loss("dlr", goal, classes)
    with pytest.raises(InvalidRequest, match=f"dlr needs at least {least} classes .* here are {least - 1}") as error:
        check_loss("dlr", goal, classes - 1)
    assert error.value.field == "attack.loss"
    check_loss("margin", goal, 2)
