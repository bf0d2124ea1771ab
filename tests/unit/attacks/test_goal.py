import pytest
import torch

from services.attacks.goal import ResolvedGoal
from services.errors import InvalidRequest

LEAVE, REACH = ResolvedGoal(0, None), ResolvedGoal(None, 1)


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
        ResolvedGoal(None, None)


@pytest.mark.parametrize("ask", [ResolvedGoal.objective, ResolvedGoal.advantage])
def test_a_network_with_one_label_cannot_be_brought_to_another(ask) -> None:
    with pytest.raises(InvalidRequest, match="one label only") as refused:
        ask(ResolvedGoal(0, None), torch.tensor([[3.0]]))
    assert refused.value.field == "target.name"


def test_to_minimise_the_objective_is_to_reach_the_label_or_to_leave_it() -> None:
    """Closed form: the log-odds of two labels are the difference of their scores."""
    scores = torch.tensor([[0.3, 2.0], [1.5, -0.4]], dtype=torch.float64)
    torch.testing.assert_close(LEAVE.objective(scores), torch.tensor([-1.7, 1.9], dtype=torch.float64))
    torch.testing.assert_close(REACH.objective(scores), torch.tensor([-1.7, 1.9], dtype=torch.float64))
    torch.testing.assert_close(ResolvedGoal(1, 0).objective(scores), torch.tensor([1.7, -1.9], dtype=torch.float64))
