from math import log

import pytest
import torch

from scene_attack.analysis.subsets import scored, subsets
from scene_attack.attacks.run import Verifier
from tests.unit.attacks.small import problem


def test_every_subset_once_and_the_ends_are_the_original_and_the_attacked() -> None:
    case = problem()
    verifier = Verifier(case.renderer, case.target)
    perturbation = {"a": torch.full((2, 3), 0.05), "b": torch.full((3,), 0.3)}
    known = scored(verifier, {}), scored(verifier, perturbation)
    asked = verifier.counts.queries
    rows = subsets(verifier, case.goal, perturbation, *known)
    assert verifier.counts.queries == asked + 2  # what is known is not asked again
    assert [row.groups for row in rows] == [[], ["a"], ["b"], ["a", "b"]]
    assert rows[0].perceptibility == 0
    assert not rows[0].fooled
    for row in rows:
        exact = verifier.render({g: perturbation[g] for g in row.groups})
        fresh = verifier.logits(verifier.image({g: perturbation[g] for g in row.groups}))
        truth = float(torch.softmax(fresh, 0)[case.goal.labels[0]])
        assert row.goal_log_odds == pytest.approx(log(truth / (1 - truth)), abs=1e-9)
        change = float((exact - known[0].exact).square().sum(dim=-1).mean().sqrt())
        assert row.float_perceptibility == pytest.approx(change, rel=1e-12)
        assert row.goal_probability == float(torch.softmax(fresh.double(), 0)[case.goal.labels[0]])
        assert row.fooled == (int(fresh.argmax()) != case.goal.labels[0])
    assert len({row.fooled for row in rows[1:]}) == 2, "the subsets are all alike"
    # a subset applies its own groups and no other
    assert len({row.perceptibility for row in rows}) == 4
