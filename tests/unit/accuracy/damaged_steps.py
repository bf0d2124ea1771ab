"""Ways to break gradients, differences and the steps made of them."""

from dataclasses import replace

import torch

from services.accuracy.stability import attacks
from services.attacks import differences, goal, limits, problem, zoo
from services.attacks.differences import Estimate
from services.attacks.fgsm import Fgsm
from services.attacks.goal import ResolvedGoal
from services.attacks.problem import AttackProblem
from services.attacks.zoo import Zoo


def estimates(change):
    """Breaks every estimate of a gradient by differences: `change`(true, problem, at, coordinates, deltas, noise)."""

    def apply(patch) -> None:
        true = differences.estimate
        for module in (attacks, differences):
            patch.setattr(module, "estimate", lambda *given: change(true, *given))

    return apply


def _one_sided(_, problem, at, coordinates, half_steps, noise):
    moved = at.repeat(len(coordinates) + 1, 1)
    moved[torch.arange(len(coordinates)), coordinates] += half_steps.to(moved.dtype)
    scores = problem.objectives(moved)
    change = scores[:-1] - scores[-1]
    below_noise = change.abs() <= noise
    return Estimate(torch.where(below_noise, 0.0, change / half_steps), below_noise)


def _scaled(true, *given):
    found = true(*given)
    return replace(found, gradients=2 * found.gradients)


one_sided_differences = estimates(_one_sided)
differences_over_one_step = estimates(_scaled)


def negative_weight(patch) -> None:
    """λ rewards large changes."""
    true = AttackProblem.penalty
    patch.setattr(AttackProblem, "penalty", lambda self, images: -true(self, images))


def weight_of_distance(patch) -> None:
    """λ times the length of the change, not its square."""
    true = problem.distances
    patch.setattr(problem, "distances", lambda *given: true(*given).sqrt())


def gradient_through_held_pixels(patch) -> None:
    true = limits.truncate

    def truncate(images, original, limit):
        held, which = true(images, original, limit)
        return images + (held - images).detach(), which

    patch.setattr(limits, "truncate", truncate)


def truncated_around_grey(patch) -> None:
    true = limits.truncate

    def truncate(images, original, limit):
        return true(images, torch.full_like(original, 0.5), limit)

    patch.setattr(limits, "truncate", truncate)


def twice_the_limit(patch) -> None:
    true = limits.truncate
    patch.setattr(limits, "truncate", lambda images, original, limit: true(images, original, limit and 2 * limit))


def settings(**changed):
    """Breaks FGSM by ignoring settings."""

    def apply(patch) -> None:
        true = Fgsm.step
        patch.setattr(Fgsm, "step", lambda self, *given: true(self.model_copy(update=changed), *given))

    return apply


no_momentum = settings(momentum=0.0)
no_decay = settings(weight_decay=0.0)


def cut_velocity(patch) -> None:
    """What bounds take from a step they take from the momentum too."""
    true = Fgsm.step

    def step(self, problem, state, evaluation):
        after = true(self, problem, state, evaluation)
        rates = problem.layout.spread(self.learning_rate).clamp_min(1e-9)
        return after | {"velocity": ((state["delta"] - after["delta"]) / rates).to(after["velocity"].dtype)}

    patch.setattr(Fgsm, "step", step)


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


def no_bias_correction(patch) -> None:
    """Adam's moments count as if there had been a million steps."""
    true = Zoo.init

    def init(self, problem):
        state = true(self, problem)
        return state | {"moves": state["moves"] + 10**6}

    patch.setattr(Zoo, "init", init)


def swapped_betas(patch) -> None:
    patch.setattr(zoo, "BETAS", zoo.BETAS[::-1])


def unmeasured_step(patch) -> None:
    """The difference step is not measured."""
    patch.setattr(differences, "measure_half_steps", lambda problem, *_: dict.fromkeys(problem.layout.groups, 1e-4))
