import torch

from services.analysis.subsets import subsets
from services.attacks.verifier import Verifier
from tests.unit.attacks.small import problem


def test_every_subset_once_and_the_ends_are_the_original_and_the_attacked() -> None:
    case = problem()
    verifier = Verifier(case.renderer, case.target)
    perturbation = {"a": torch.full((2, 3), 0.05), "b": torch.full((3,), 0.3)}
    original, attacked = verifier.image({}), verifier.image(perturbation)
    known = [(image, verifier.logits(image)) for image in (original, attacked)]
    asked = verifier.queries
    rows = subsets(verifier, case.goal, perturbation, *known)
    assert verifier.queries == asked + 2  # what is known is not asked again
    assert [row.groups for row in rows] == [[], ["a"], ["b"], ["a", "b"]]
    assert rows[0].perceptibility == 0
    assert not rows[0].fooled
    for row in rows:
        fresh = verifier.logits(verifier.image({g: perturbation[g] for g in row.groups}))
        assert row.goal_probability == float(torch.softmax(fresh.double(), 0)[case.goal.labels[0]])
        assert row.fooled == (int(fresh.argmax()) != case.goal.labels[0])
    assert len({row.fooled for row in rows[1:]}) == 2, "the subsets are all alike"
    # a subset applies its own groups and no other
    assert len({row.perceptibility for row in rows}) == 4
