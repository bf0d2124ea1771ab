"""Previews a request: the image of its scene, the network's first answers, and the plan with its cost."""

from collections.abc import Callable
from time import perf_counter

import torch
from torch import Tensor

from scene_attack.runs.prepare import load_targets, plan_of, prepare, prepare_exactly
from scene_attack.runs.result import Cost, PlannedCost, Preview
from scene_attack.runs.spec import JobSpec
from scene_attack.scenes.library import Library


def preview(spec: JobSpec, library: Library) -> tuple[Preview, Tensor]:
    """Returns the first answers and warnings of a job of this request, and the image of its scene, uint8 [H, W, 3].

    Raises InvalidRequest as `prepare` does, but for a plan that cannot be made.
    """
    prepared = prepare_exactly(spec, library)
    load_targets(spec)
    answers = prepared.task.first_answers(prepared.original.saved, prepared.original.logits, prepared.settled.goal)
    return Preview(spec=prepared.spec, answers=answers, warnings=prepared.settled.warnings), prepared.original.saved


def planned_cost(spec: JobSpec, library: Library) -> PlannedCost:
    """Returns the plan of a request and its cost, for which it draws an image and asks the network once more.

    Raises InvalidRequest if the request cannot run, as `prepare` does.
    """
    prepared = prepare(spec, library)
    renderer, verifier = prepared.renderer, prepared.verifier
    start = {group: value[None] for group, value in renderer.initial().items() if group in renderer.plan.groups}
    image = _seconds(lambda: renderer.render(start))
    query = _seconds(lambda: verifier.logits(prepared.original.saved))
    attack = prepared.spec.attack
    cost = Cost(
        steps=attack.steps,
        queries=attack.queries,
        image_seconds=image,
        query_seconds=query,
        least_seconds=attack.steps * (image + query),
    )
    return PlannedCost(plan=plan_of(prepared), cost=cost)


@torch.no_grad()
def _seconds(work: Callable[[], Tensor]) -> float:
    began = perf_counter()
    work().cpu()  # what runs on a graphics card has ended then
    return perf_counter() - began
