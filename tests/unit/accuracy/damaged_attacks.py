"""Ways to break scores, goals, attacks and seeds, each as a function of pytest's monkeypatch."""

import torch

from services.accuracy.stability import attacks, networks
from services.attacks import differences as attack_differences
from services.attacks import goal, limits, run
from services.attacks.differences import Estimate
from services.attacks.fgsm import Fgsm
from services.rendering import color
from services.targets.classifier import Classifier


def odds_of_probabilities(patch) -> None:
    """Log-odds from the softmax: the dead zone of a certain network."""

    def log_odds(scores, labels):
        p = torch.softmax(scores, dim=-1)[..., labels[0]]
        return torch.log(p / (1 - p))

    patch.setattr(goal, "log_odds", log_odds)


def no_odds(patch) -> None:
    patch.setattr(goal, "log_odds", lambda scores, labels: 0 * scores[..., labels[0]])


def odds_by_largest(patch) -> None:
    """The margin in place of the log-odds."""
    patch.setattr(goal, "log_odds", lambda scores, labels: scores[..., labels[0]] - scores.amax(-1))


def narrow_odds(patch) -> None:
    true = goal.log_odds
    patch.setattr(goal, "log_odds", lambda scores, labels: true(scores, labels).to(scores.dtype))


def ties_by_value(patch) -> None:
    """Fooled where another score is as large."""

    def fooled(self, scores):
        (label,) = self.labels
        others = scores.scatter(-1, torch.full((*scores.shape[:-1], 1), label), -torch.inf)
        return scores[..., label] <= others.amax(-1)

    patch.setattr(goal.ResolvedGoal, "fooled", fooled)


def any_number_of_labels(patch) -> None:
    patch.setattr(goal, "_several", lambda *_: None)


def never_flat(patch) -> None:
    """Differences of rounding are taken for gradients; the way between the sides is always said to be 2δ and more."""
    true = attacks.estimate

    def estimate(*given):
        found = true(*given[:-1], -1.0)
        return Estimate(1.3 * found.gradients + 1e-3, torch.zeros_like(found.below_noise))

    for module in (attacks, attack_differences):
        patch.setattr(module, "estimate", estimate)


def no_bounds(patch) -> None:
    patch.setattr(limits.Limits, "clamp", lambda _, deltas: deltas)


def drifting(patch) -> None:
    """Every step goes a little further than it should, and none is reported flat."""
    true = Fgsm.step

    def step(self, *given):
        state = true(self, *given)
        return state | {"delta": state["delta"] * 1.01 + 1e-3, "below_noise": torch.tensor(0)}

    patch.setattr(Fgsm, "step", step)


def runaway(patch) -> None:
    """Steps that grow without end."""
    true = Fgsm.step

    def step(self, *given):
        state = true(self, *given)
        return state | {"delta": state["delta"] * torch.inf}

    patch.setattr(Fgsm, "step", step)


def silent(patch) -> None:
    """A gradient of zero is not reported."""
    patch.setattr(run, "below_noise", lambda *_: 0)


def exact_limit(patch) -> None:
    """U without an allowance for rounding."""
    patch.setattr(limits, "ROUNDING", 0.0)


def no_limit(patch) -> None:
    """Nothing is held back at U."""
    true = limits.truncate

    def truncate(images, original, limit):
        return images, true(images, original, limit)[1]

    patch.setattr(limits, "truncate", truncate)


def narrow_rounding(patch) -> None:
    """Images are rounded to 8 bits in their own type."""

    def as_saved(images):
        return color.from_bytes((images.clamp(0, 1) * 255).round().to(torch.uint8))

    patch.setattr(networks, "as_saved", as_saved)


def narrow_scores(patch) -> None:
    true = Classifier.logits
    patch.setattr(Classifier, "logits", lambda self, *given: true(self, *given).to(self.dtype))


def short_seeds(patch) -> None:
    """Seeds of 32 bits."""
    true = networks.generator
    patch.setattr(networks, "generator", lambda seed, *words: true(seed % 2**32, *words))


def any_seed(patch) -> None:
    patch.setattr(networks, "Seed", int)
