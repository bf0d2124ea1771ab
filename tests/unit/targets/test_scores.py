import math

import pytest
import torch

from scene_attack.targets.scores import advantage, log_odds, probability


@pytest.mark.parametrize("margin", [0.0, 5.0, 20.0, 90.0, 1000.0])
def test_against_exact_arithmetic(margin: float) -> None:
    logits = torch.tensor([[margin, 0.0, 0.0]])
    assert float(log_odds(logits, 0)) == pytest.approx(margin - math.log(2), rel=1e-6, abs=1e-6)
    assert float(probability(logits, 0)) == pytest.approx(1 / (1 + 2 * math.exp(-margin)), rel=1e-12)
    assert float(probability(logits, 1)) == pytest.approx(math.exp(-margin) / (1 + 2 * math.exp(-margin)), rel=1e-6)
    assert float(advantage(logits, 0)) == margin
    assert float(advantage(logits, 1)) == -margin


def test_scores_of_eight_bits_are_summed_in_more() -> None:
    """A sum of a thousand exponentials in bfloat16 would be off by 6e-3."""
    scores = torch.randn(20, 1000, generator=torch.Generator().manual_seed(4)).bfloat16()
    torch.testing.assert_close(log_odds(scores, 7).double(), log_odds(scores.double(), 7), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(advantage(scores, 7).double(), advantage(scores.double(), 7), rtol=1e-6, atol=1e-6)
