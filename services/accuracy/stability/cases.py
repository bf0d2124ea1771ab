"""All stiff and extreme cases, one after another."""

from collections.abc import Callable, Sequence

from services.accuracy.stability import (
    differences,
    environments,
    lights,
    lobes,
    logits,
    materials,
    meshes,
    normals,
    plans,
    poses,
    precision,
    recurrences,
    shadows,
    sizes,
    steps,
    textures,
    views,
)
from services.accuracy.stability.case import Case, Observation, observe

FAMILIES = (
    lobes,
    normals,
    environments,
    plans,
    views,
    poses,
    meshes,
    textures,
    materials,
    lights,
    shadows,
    logits,
    differences,
    recurrences,
    steps,
    sizes,
    precision,
)


def cases(quick: bool = False) -> list[Case]:
    """Every case, in the order of the report; with `quick` those that take a second or two at most."""
    found = [case for family in FAMILIES for case in family.cases()]
    return [case for case in found if not (quick and case.slow)]


def run(chosen: Sequence[Case], on_case: Callable[[Case], None] = lambda _: None) -> list[Observation]:
    """Runs the cases; `on_case` is called before each."""
    observations = []
    for case in chosen:
        on_case(case)
        observations.append(observe(case))
    return observations
