"""Goals as numbers, and the losses against their formulas written out with sorted lists."""

from math import log

import pytest
import torch

from scene_attack.attacks.goal import ResolvedGoal, check_loss, loss
from scene_attack.attacks.request import LOSSES
from scene_attack.errors import InvalidRequest

LEAVE, REACH = ResolvedGoal((0,), None), ResolvedGoal((), 1)


def test_the_objective_has_the_direction_of_the_probability() -> None:
    logits = torch.randn(5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    (odds,) = torch.autograd.grad(LEAVE.objective(logits).sum(), logits)
    (probability,) = torch.autograd.grad(torch.softmax(logits, -1)[:, 0].sum(), logits)
    # d log-odds = dp / (p (1 − p)): the same direction, row by row
    torch.testing.assert_close(torch.nn.functional.cosine_similarity(odds, probability), torch.ones(5).double())


@pytest.mark.parametrize("margin", [20.0, 90.0, 1000.0])
def test_a_confident_network_keeps_a_gradient(margin: float) -> None:
    """The probability's float32 gradient is gone at these margins; the log-odds' never is."""
    logits = torch.zeros(1, 10).index_fill(1, torch.tensor([0]), margin).requires_grad_()
    (gradient,) = torch.autograd.grad(LEAVE.objective(logits).sum(), logits)
    assert gradient[0, 0] == 1
    torch.testing.assert_close(gradient[0, 1:], torch.full((9,), -1 / 9))
    if margin >= 90:
        (lost,) = torch.autograd.grad(torch.softmax(logits, -1)[:, 0].sum(), logits)
        assert lost.abs().max() < 1e-30


def test_targeted_and_non_targeted_agree_with_the_definition() -> None:
    logits = torch.tensor([[2.0, 1.0, 0.0], [0.0, 3.0, 1.0]])
    p = torch.softmax(logits.double(), -1)
    torch.testing.assert_close(LEAVE.loss(logits), p[:, 0])
    torch.testing.assert_close(REACH.loss(logits), 1 - p[:, 1])
    assert LEAVE.advantage(logits).tolist() == [1.0, -3.0]
    assert REACH.advantage(logits).tolist() == [1.0, -2.0]
    assert LEAVE.fooled(logits).tolist() == REACH.fooled(logits).tolist() == [False, True]


def test_a_tie_is_not_a_success_for_the_lower_index() -> None:
    tied = torch.tensor([[1.0, 1.0, 0.0]])
    assert not LEAVE.fooled(tied)
    assert LEAVE.advantage(tied) == 0


def test_one_class_is_certain_and_never_fooled() -> None:
    only = torch.tensor([[5.0]])
    assert LEAVE.loss(only) == 1
    assert not LEAVE.fooled(only)


def test_a_goal_wants_something() -> None:
    with pytest.raises(ValueError, match="leave or to reach"):
        ResolvedGoal((), None)


@pytest.mark.parametrize("ask", [ResolvedGoal.objective, ResolvedGoal.advantage])
def test_a_network_with_one_label_cannot_be_brought_to_another(ask) -> None:
    with pytest.raises(InvalidRequest, match="no other answer") as refused:
        ask(ResolvedGoal((0,), None), torch.tensor([[3.0]]))
    assert refused.value.field == "target.name"


def test_to_minimise_the_objective_is_to_reach_the_label_or_to_leave_it() -> None:
    """Closed form: the log-odds of two labels are the difference of their scores."""
    scores = torch.tensor([[0.3, 2.0], [1.5, -0.4]], dtype=torch.float64)
    torch.testing.assert_close(LEAVE.objective(scores), torch.tensor([-1.7, 1.9], dtype=torch.float64))
    torch.testing.assert_close(REACH.objective(scores), torch.tensor([-1.7, 1.9], dtype=torch.float64))
    torch.testing.assert_close(ResolvedGoal((1,), 0).objective(scores), torch.tensor([1.7, -1.9], dtype=torch.float64))


# Sets of labels, by hand: scores are logarithms of weights, so that probabilities are fractions of their sum

WEIGHTS = torch.tensor([[4.0, 2.0, 1.0, 1.0], [1.0, 2.0, 4.0, 1.0]], dtype=torch.float64)
SET = ResolvedGoal((0, 1), None)


def test_a_set_of_labels_counts_as_one_answer() -> None:
    scores = WEIGHTS.log()
    torch.testing.assert_close(SET.loss(scores), torch.tensor([6 / 8, 3 / 8], dtype=torch.float64))
    torch.testing.assert_close(SET.objective(scores), torch.tensor([log(6 / 2), log(3 / 5)], dtype=torch.float64))
    torch.testing.assert_close(SET.advantage(scores), torch.tensor([log(4 / 1), log(2 / 4)], dtype=torch.float64))
    assert SET.fooled(scores).tolist() == [False, True]
    within = torch.tensor([[2.0, 4.0, 1.0, 1.0]]).log()
    assert not SET.fooled(within), "an answer that counts as the same one is no other answer"


def test_the_gradient_of_a_set_has_the_direction_of_its_probability() -> None:
    logits = torch.randn(5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    goal = ResolvedGoal((1, 4, 5), None)
    (odds,) = torch.autograd.grad(goal.objective(logits).sum(), logits)
    (probability,) = torch.autograd.grad(torch.softmax(logits, -1)[:, [1, 4, 5]].sum(), logits)
    torch.testing.assert_close(torch.nn.functional.cosine_similarity(odds, probability), torch.ones(5).double())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_set_of_one_is_its_label_to_the_bit(dtype: torch.dtype) -> None:
    """z − logsumexp of the others, as goals of a single label have always been."""
    logits = 8 * torch.randn(64, 1000, dtype=dtype, generator=torch.Generator().manual_seed(0))
    others = logits[:, [i for i in range(1000) if i != 7]]
    goal = ResolvedGoal((7,), None)
    without = logits.index_fill(-1, torch.tensor([7]), -torch.inf)
    assert torch.equal(goal.objective(logits), logits[:, 7] - torch.logsumexp(without, -1))
    assert torch.equal(goal.advantage(logits), logits[:, 7] - others.amax(-1))
    assert torch.equal(goal.loss(logits), torch.softmax(logits.double(), -1)[:, 7])


def test_the_new_answer_must_have_the_least_confidence() -> None:
    scores = WEIGHTS.log()  # the answer to the second row has probability 4 / 8
    for least, met in ((0.0, True), (0.49, True), (0.51, False)):
        assert ResolvedGoal((0, 1), None, least).fooled(scores).tolist() == [False, met]
        assert ResolvedGoal((0, 1), 2, least).fooled(scores).tolist() == [False, met]


@pytest.mark.parametrize("reach", [None, 2])
@pytest.mark.parametrize("least", [0.0, 0.3, 0.6, 0.9])
def test_the_advantage_is_negative_where_the_goal_is_met_and_nowhere_else(reach: int | None, least: float) -> None:
    logits = 3 * torch.randn(2000, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    goal = ResolvedGoal((0, 1), reach, least)
    met = goal.fooled(logits)
    assert 0 < met.sum() < len(met)
    assert torch.equal(goal.advantage(logits) < 0, met)


def test_with_a_least_confidence_the_objective_raises_one_other_label() -> None:
    """By hand: the best label outside the set has weight 1 of 8 in the first row and 4 of 8 in the second."""
    goal = ResolvedGoal((0, 1), None, 0.5)
    torch.testing.assert_close(goal.objective(WEIGHTS.log()), torch.tensor([log(7), 0.0], dtype=torch.float64))


@pytest.mark.parametrize("least", [-0.1, 1.0, float("nan")])
def test_a_least_confidence_is_a_probability_below_1(least: float) -> None:
    with pytest.raises(ValueError, match="least confidence"):
        ResolvedGoal((0,), None, least)


@pytest.mark.parametrize("ask", [ResolvedGoal.objective, ResolvedGoal.advantage])
def test_a_set_of_all_labels_leaves_no_other_answer(ask) -> None:
    with pytest.raises(InvalidRequest, match="no other answer"):
        ask(ResolvedGoal((0, 1, 2), None), torch.zeros(1, 3))


def test_the_least_confidence_itself_is_enough() -> None:
    """Two equal scores: the lower index is the answer, with a probability of exactly 1/2."""
    scores = torch.zeros(2, dtype=torch.float64)
    assert bool(ResolvedGoal((1,), None, 0.5).fooled(scores))
    assert not bool(ResolvedGoal((1,), None, 0.5000001).fooled(scores))


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
