"""The range over which an attack averages: the groups that it moves, whether the renderer reaches it, and its cost."""

from dataclasses import replace
from math import radians
from typing import Any

import torch

from services.attacks.attack import Attack
from services.attacks.request import VIEWS, Expectation
from services.errors import InvalidRequest
from services.rendering.declaration import RENDERERS
from services.rendering.plan import Plan, Stage
from services.rendering.protocol import Renderer
from services.rendering.variation import STILL, moved, varied


def moving_groups(attack: Attack) -> tuple[str, ...]:
    """The groups whose values change inside an attack: the attacked ones, and those that its range moves."""
    declared = RENDERERS[attack.renderer]
    asked = attack.expectation
    ranged = [group for name, group in declared.varies.items() if asked is not None and getattr(asked, name)]
    return tuple(group for group in declared.group_names if group in attack.groups or group in ranged)


def check_range(asked: Expectation, renderer: Renderer) -> None:
    """Raises InvalidRequest naming the range whose ends are beyond the renderer's bounds."""
    start = {group: value[None] for group, value in renderer.initial().items()}
    for name in (one for one in VIEWS if getattr(asked, one)):
        width = getattr(asked, name)
        for sign in (-1, 1):
            value: Any = 1 + sign * width if name == "distance" else sign * radians(width)
            end = replace(STILL, **{name: value})
            reached, kept = moved(renderer, start, end), varied(renderer, start, end)
            if any(not torch.equal(reached[group], kept[group]) for group in reached):
                raise InvalidRequest(
                    f"attack.expectation.{name}", "an end of this range is beyond the camera's limits; make it smaller"
                )


def with_cost(plan: Plan, asked: Expectation | None) -> Plan:
    """The plan with the cost of averaging, if the attack averages."""
    if asked is None:
        return plan
    stage = Stage(
        name="expectation",
        method=f"the mean over the scene itself and {asked.samples} variations of it",
        when="every image",
        evaluations=1 + asked.samples,
        unit="images and queries",
        why=f"the adversary is to hold for a range; its share is measured on {asked.checks} fresh variations at the "
        f"end, by up to {2 * asked.checks} exact images and queries",
    )
    return plan.model_copy(update={"stages": (*plan.stages, stage)})
