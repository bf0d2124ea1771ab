"""Ways to break scores, goals, gradients, steps and seeds."""

from dataclasses import replace

import torch

from scene_attack.attacks import differences, goal, limits, problem, run, zoo
from scene_attack.attacks import differences as attack_differences
from scene_attack.attacks.differences import Estimate
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import AttackProblem
from scene_attack.attacks.zoo import ZOO
from scene_attack.rendering import color
from scene_attack.targets.classifier import Classifier
from scene_attack_accuracy.stability import attacks, networks
from tests.unit.accuracy.damage import breaks


@breaks("log_odds", goal)
def odds_of_probabilities(_, scores, labels):
    """Log-odds from the softmax: the dead zone of a certain network."""
    p = torch.softmax(scores, dim=-1)[..., labels[0]]
    return torch.log(p / (1 - p))


def no_odds(patch) -> None:
    patch.setattr(goal, "log_odds", lambda scores, labels: 0 * scores[..., labels[0]])


def odds_by_largest(patch) -> None:
    """The margin in place of the log-odds."""
    patch.setattr(goal, "log_odds", lambda scores, labels: scores[..., labels[0]] - scores.amax(-1))


def narrow_odds(patch) -> None:
    true = goal.log_odds
    patch.setattr(goal, "log_odds", lambda scores, labels: true(scores, labels).to(scores.dtype))


@breaks("fooled", goal.ResolvedGoal)
def ties_by_value(_, self, scores):
    """Fooled where another score is as large."""
    (label,) = self.labels
    others = scores.scatter(-1, torch.full((*scores.shape[:-1], 1), label), -torch.inf)
    return scores[..., label] <= others.amax(-1)


def any_number_of_labels(patch) -> None:
    patch.setattr(goal, "_several", lambda *_: None)


@breaks("estimate", attacks, attack_differences)
def never_flat(true, *given):
    """Differences of rounding are taken for gradients; the way between the sides is always said to be 2δ and more."""
    found = true(*given[:-1], -1.0)
    return Estimate(1.3 * found.gradients + 1e-3, torch.zeros_like(found.below_noise))


def no_bounds(patch) -> None:
    patch.setattr(limits.Limits, "clamp", lambda _, deltas: deltas)


@breaks("step", FGSM)
def drifting(true, self, *given):
    """Every step goes a little further than it should, and none is reported flat."""
    state = true(self, *given)
    return state | {"delta": state["delta"] * 1.01 + 1e-3, "below_noise": torch.tensor(0)}


@breaks("step", FGSM)
def runaway(true, self, *given):
    """Steps that grow without end."""
    state = true(self, *given)
    return state | {"delta": state["delta"] * torch.inf}


def silent(patch) -> None:
    """A gradient of zero is not reported."""
    patch.setattr(run, "below_noise", lambda *_: 0)


def exact_limit(patch) -> None:
    """U without an allowance for rounding."""
    patch.setattr(limits, "ROUNDING", 0.0)


@breaks("truncate", limits)
def no_limit(true, images, original, limit):
    """Nothing is held back at U."""
    return images, true(images, original, limit)[1]


@breaks("as_saved", networks)
def narrow_rounding(_, images):
    """Images are rounded to 8 bits in their own type."""
    return color.from_bytes((images.clamp(0, 1) * 255).round().to(torch.uint8))


def narrow_scores(patch) -> None:
    true = Classifier.logits
    patch.setattr(Classifier, "logits", lambda self, *given: true(self, *given).to(self.dtype))


def short_seeds(patch) -> None:
    """Seeds of 32 bits."""
    true = networks.generator
    patch.setattr(networks, "generator", lambda seed, *words: true(seed % 2**32, *words))


def any_seed(patch) -> None:
    patch.setattr(networks, "Seed", int)


@breaks("estimate", attacks, differences)
def one_sided_differences(_, problem, at, coordinates, half_steps, noise, *_step):
    moved = at.repeat(len(coordinates) + 1, 1)
    moved[torch.arange(len(coordinates)), coordinates] += half_steps.to(moved.dtype)
    scores = problem.objectives(moved)
    change = scores[:-1] - scores[-1]
    below_noise = change.abs() <= noise
    return Estimate(torch.where(below_noise, 0.0, change / half_steps), below_noise)


@breaks("estimate", attacks, differences)
def differences_over_one_step(true, *given):
    found = true(*given)
    return replace(found, gradients=2 * found.gradients)


def negative_weight(patch) -> None:
    """λ rewards large changes."""
    true = AttackProblem.penalty
    patch.setattr(AttackProblem, "penalty", lambda self, images: -true(self, images))


def weight_of_distance(patch) -> None:
    """λ times the length of the change, not its square."""
    true = problem.distances
    patch.setattr(problem, "distances", lambda *given: true(*given).sqrt())


@breaks("truncate", limits)
def gradient_through_held_pixels(true, images, original, limit):
    held, which = true(images, original, limit)
    return images + (held - images).detach(), which


@breaks("truncate", limits)
def truncated_around_grey(true, images, original, limit):
    return true(images, torch.full_like(original, 0.5), limit)


def twice_the_limit(patch) -> None:
    true = limits.truncate
    patch.setattr(limits, "truncate", lambda images, original, limit: true(images, original, limit and 2 * limit))


def settings(**changed):
    """Breaks FGSM by ignoring settings."""
    return breaks("step", FGSM)(lambda true, self, *given: true(self.model_copy(update=changed), *given))


no_momentum = settings(momentum=0.0)
no_decay = settings(weight_decay=0.0)


@breaks("step", FGSM)
def cut_velocity(true, self, problem, state, evaluation):
    """What bounds take from a step they take from the momentum too."""
    after = true(self, problem, state, evaluation)
    rates = problem.layout.spread(self.learning_rate).clamp_min(1e-9)
    return after | {"velocity": ((state["delta"] - after["delta"]) / rates).to(after["velocity"].dtype)}


def uphill(patch) -> None:
    """The objective's sign."""
    true = ResolvedGoal.objective
    patch.setattr(ResolvedGoal, "objective", lambda self, logits: -true(self, logits))


def negative_advantage(patch) -> None:
    true = goal.advantage
    patch.setattr(goal, "advantage", lambda logits, label: -true(logits, label))


def hinged_advantage(patch) -> None:
    """The advantage stops at 0, as the paper's loss does."""
    true = goal.advantage
    patch.setattr(goal, "advantage", lambda logits, label: true(logits, label).clamp_min(0))


@breaks("init", ZOO)
def no_bias_correction(true, self, problem):
    """Adam's moments count as if there had been a million steps."""
    state = true(self, problem)
    return state | {"moves": state["moves"] + 10**6}


def swapped_betas(patch) -> None:
    patch.setattr(zoo, "BETAS", zoo.BETAS[::-1])


def unmeasured_step(patch) -> None:
    """The difference step is not measured."""
    patch.setattr(differences, "measure_half_steps", lambda problem, *_: dict.fromkeys(problem.layout.groups, 1e-4))
