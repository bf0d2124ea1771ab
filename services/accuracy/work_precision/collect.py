"""Error against run time: methods of shading, estimates of gradients, signs, whole attacks. Resumable."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

from services.accuracy.work_precision import (
    attack_runs,
    gradients_pyrender,
    gradients_torch,
    map_resolution,
    network_signs,
    scene_options,
    shadow_resolution,
)
from services.accuracy.work_precision.attack_runs import AttackRow
from services.accuracy.work_precision.convergence import OrderRow, shading_orders, smooth_orders
from services.accuracy.work_precision.extent import Extent
from services.accuracy.work_precision.gradients import (
    GradientRow,
    Objective,
    Reference,
    along_directions,
    differences,
)
from services.accuracy.work_precision.independent_check import IndependentRow, comparisons
from services.accuracy.work_precision.map_resolution import MapRow
from services.accuracy.work_precision.network_signs import SignRow
from services.accuracy.work_precision.progress import Progress
from services.accuracy.work_precision.scene_options import SceneRow
from services.accuracy.work_precision.shading_methods import TOO_MANY, ShadingMethod, methods
from services.accuracy.work_precision.shading_rows import CannotRunRow, ShadingRow, row, truth
from services.accuracy.work_precision.shading_subject import subject
from services.accuracy.work_precision.shadow_resolution import ShadowRow
from services.accuracy.work_precision.success import SuccessRow, success_rows

Scene = tuple[str, str, tuple[int, int], tuple[int, int]]
"""Mesh, material, size of the image and of the map."""


@dataclass(frozen=True)
class Found:
    """Everything that was measured, and what follows from it."""

    independent: list[IndependentRow] = field(default_factory=list)
    shading: list[ShadingRow] = field(default_factory=list)
    cannot_run: list[CannotRunRow] = field(default_factory=list)
    maps: list[MapRow] = field(default_factory=list)
    shadows: list[ShadowRow] = field(default_factory=list)
    scenes: list[SceneRow] = field(default_factory=list)
    orders: list[OrderRow] = field(default_factory=list)
    signs: list[SignRow] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    gradients: list[GradientRow] = field(default_factory=list)
    attacks: list[AttackRow] = field(default_factory=list)
    success: list[SuccessRow] = field(default_factory=list)


@dataclass(frozen=True)
class Part:
    """A part of the report that can be measured by itself: `measure` adds to `fields` of what was found."""

    measure: Callable[[Extent, Progress, Found], None]
    fields: tuple[str, ...]


def collect(extent: Extent, progress: Progress | None = None, only: Sequence[str] = ()) -> Found:
    """Measures the parts named in `only`, or all of PARTS, or takes from `progress` what it has of them."""
    progress, found = progress or Progress(), Found()
    for name in only or PARTS:
        PARTS[name].measure(extent, progress, found)
    return found


def shading(extent: Extent, progress: Progress, found: Found) -> None:
    """Every method of shading, for every subject and size of its map; and the independent program on each."""
    for mesh, material, size, maps in extent.subjects:
        for texels in maps:
            scene, name = (mesh, material, size, texels), f"{mesh}, map {texels[0]}×{texels[1]}"
            possible = [method for method in methods(extent.quick) if method.suits(texels)]
            found.shading.extend(
                progress.rows(f"shading: {name}", ShadingRow, partial(_measured, scene, possible, extent))
            )
            found.independent.extend(
                progress.rows(f"independent: {name}", IndependentRow, partial(_independent, scene))
            )
            left_out = len(methods(extent.quick)) - len(possible)
            if left_out:
                found.cannot_run.append(CannotRunRow(mesh=mesh, map=texels, why=TOO_MANY, methods=left_out))
    mesh, material, size, maps = extent.subjects[0]
    smooth = progress.rows(
        "orders: smooth",
        OrderRow,
        lambda: list(smooth_orders(subject(mesh, material, size, maps[0]).surface.angles)),
    )
    found.orders.extend([*smooth, *shading_orders(found.shading)])


def _measured(scene: Scene, possible: list[ShadingMethod], extent: Extent) -> list[ShadingRow]:
    of = subject(*scene)
    truths = {groups: truth(of, groups) for groups in dict.fromkeys(method.groups for method in possible)}
    return [row(method, of, truths[method.groups], extent.enough) for method in possible]


def _independent(scene: Scene) -> list[IndependentRow]:
    return list(comparisons(subject(*scene)))


def maps(extent: Extent, progress: Progress, found: Found) -> None:
    """What the map's resolution costs an object."""
    mesh, _, size, _ = extent.subjects[0]
    found.maps.extend(progress.rows("maps", MapRow, lambda: list(map_resolution.rows(mesh, size))))


def shadows(extent: Extent, progress: Progress, found: Found) -> None:
    """What the resolution of shadows costs a scene."""
    measured = partial(shadow_resolution.rows, extent.scene, extent.enough)
    found.shadows.extend(progress.rows("shadows", ShadowRow, lambda: list(measured())))


def scenes(extent: Extent, progress: Progress, found: Found) -> None:
    """What surfaces, a floor and shadows cost a scene."""
    measured = partial(scene_options.rows, extent.scene, extent.enough)
    found.scenes.extend(progress.rows("scenes", SceneRow, lambda: list(measured())))


def signs(extent: Extent, progress: Progress, found: Found) -> None:
    """Signs of gradients through the network."""
    found.signs.extend(progress.rows("signs", SignRow, lambda: list(network_signs.rows(*extent.gradients))))


def estimates(extent: Extent, progress: Progress, found: Found) -> None:
    """Every estimate of every gradient; random directions are tried on images only, as the network costs too much."""
    all_objectives = cache(partial(objectives, extent))  # their references cost minutes

    found.references.extend(progress.rows("references", Reference, lambda: [of.reference for of in all_objectives()]))
    for number, known in enumerate(found.references):
        name = f"gradients: {known.renderer} {known.group}, {known.of}, {known.samples or 'no'} samples"

        def measured(number: int = number) -> list[GradientRow]:
            return list(estimates_of(all_objectives()[number], extent))

        found.gradients.extend(progress.rows(name, GradientRow, measured))


def objectives(extent: Extent) -> list[Objective]:
    """Every function whose gradient is estimated."""
    mesh, label, size, texels = extent.gradients
    return [
        *gradients_torch.objectives(mesh, label, size, texels),
        *gradients_pyrender.objectives(mesh, size, extent.factor),
    ]


def estimates_of(of: Objective, extent: Extent) -> Iterator[GradientRow]:
    """Every estimate of one gradient."""
    yield from differences(of)
    if of.of != gradients_torch.ODDS:
        yield from along_directions(of, extent.directions)


def attacks(extent: Extent, progress: Progress, found: Found) -> None:
    """Every attack."""
    for case in attack_runs.cases(extent.scenes, extent.steps, extent.seeds, extent.zoo):
        settings = case.attack
        groups = " ".join(settings.groups)
        name = f"{settings.method}: {case.scene}, {groups}, tolerance {case.tolerance}, seed {case.seed}"
        found.attacks.extend(progress.rows(name, AttackRow, partial(_attacked, case)))
    found.success.extend(success_rows(found.attacks))


def _attacked(case: attack_runs.Case) -> list[AttackRow]:
    return [attack_runs.attack(case)]


PARTS = {
    "shading": Part(shading, ("independent", "shading", "cannot_run", "orders")),
    "maps": Part(maps, ("maps",)),
    "shadows": Part(shadows, ("shadows",)),
    "scenes": Part(scenes, ("scenes",)),
    "signs": Part(signs, ("signs",)),
    "gradients": Part(estimates, ("references", "gradients")),
    "attacks": Part(attacks, ("attacks", "success")),
}
"""The parts by name, in the order in which they are measured."""
