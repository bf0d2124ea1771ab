"""Finds the surrogate that an attack names, and the attack's goal in its labels."""

from services.attacks.goal import ResolvedGoal
from services.attacks.problem import Surrogate
from services.errors import InvalidRequest
from services.pipeline import goals
from services.pipeline.goals import Settled
from services.pipeline.spec import JobSpec
from services.targets import registry

FIELD = "attack.surrogate"


def check_surrogate(spec: JobSpec) -> None:
    """Raises InvalidRequest("attack.surrogate") for a target that is unknown or is the one under attack."""
    name = spec.attack.guide
    if name is None:
        return
    try:
        registry.labels(name)
    except InvalidRequest as error:
        raise InvalidRequest(FIELD, error.detail) from error
    if name == spec.target.name:
        raise InvalidRequest(FIELD, f"{name} is the target itself; name another one, or choose a method with gradients")


def surrogate(spec: JobSpec, labels: tuple[str, ...], settled: Settled) -> Surrogate | None:
    """Loads the surrogate, if the attack has one. `labels` are the target's.

    The labels to leave, or the label to reach, are looked up by name; where the surrogate has none of those to leave,
    its own table says what is right for the scene. Raises InvalidRequest("attack.surrogate") for a network that cannot
    be loaded, that answers questions, whose scores have no gradients, or whose labels do not have the goal.
    """
    name = spec.attack.guide
    if name is None:
        return None
    card = registry.card(name)
    try:
        target = registry.load(name)
    except InvalidRequest as error:
        raise InvalidRequest(FIELD, error.detail) from error
    if target.takes_question:
        raise InvalidRequest(FIELD, f"{name} answers questions; it is asked without one")
    if not registry.has_gradient(name):
        raise InvalidRequest(FIELD, f"the scores of {name} have no gradients ({registry.no_gradient(name)})")
    goal, wanted = settled.goal, settled.goal.reach
    if wanted is not None:
        if labels[wanted] not in target.labels:
            raise InvalidRequest(FIELD, f"{name} has no label {labels[wanted]!r}, which the goal is to reach")
        return Surrogate(target, ResolvedGoal((), target.labels.index(labels[wanted])))
    names = [labels[index] for index in goal.leave]
    meshes = [thing.mesh for thing in spec.scene.objects]
    right = set(goal.leave) <= set(settled.truth)
    leave = goals.for_another(names, registry.card(spec.target.name), meshes if right else (), card, target.labels)
    if not leave or len(leave) == len(target.labels):
        which = "only the labels" if leave else "none of the labels"
        raise InvalidRequest(FIELD, f"{name} has {which} that the goal is to leave ({', '.join(names[:5])})")
    return Surrogate(target, ResolvedGoal(tuple(sorted(leave)), None))
