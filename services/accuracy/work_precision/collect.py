"""Error against run time: methods of shading, estimates of gradients, signs, whole attacks. Resumable."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, partial

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.work_precision import (
    attack_runs,
    gradients_pyrender,
    gradients_torch,
    map_resolution,
    network_signs,
    shadow_resolution,
)
from services.accuracy.work_precision.attack_runs import AttackRow
from services.accuracy.work_precision.convergence import OrderRow, shading_orders, smooth_orders
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
from services.accuracy.work_precision.shading_methods import TOO_MANY, ShadingMethod, methods
from services.accuracy.work_precision.shading_rows import CannotRunRow, ShadingRow, row, truth
from services.accuracy.work_precision.shading_subject import subject
from services.accuracy.work_precision.shadow_resolution import ShadowRow
from services.accuracy.work_precision.success import SuccessRow, success_rows
from services.versions import versions

Scene = tuple[str, str, tuple[int, int], tuple[int, int]]
"""Mesh, material, size of the image and of the map."""


@dataclass(frozen=True)
class Extent:
    """How much is compared.

    subjects: mesh, material, size of the image and sizes of maps that are shaded; enough: seconds for each time that
    is taken. gradients: mesh, label, size of image and of map whose gradients are estimated; factor: pixels a side in
    the references of poses; directions: counts of random ones. scenes, steps and seeds of attacks; zoo: its settings.
    """

    subjects: tuple[tuple[str, str, tuple[int, int], tuple[tuple[int, int], ...]], ...]
    enough: float
    gradients: tuple[str, str, tuple[int, int], tuple[int, int]]
    factor: int
    directions: tuple[int, ...]
    scenes: int
    steps: int
    seeds: int
    zoo: dict[str, object]
    quick: bool = False


MAPS = ((4, 8), (8, 16), (16, 32), (32, 64))
FULL = Extent(
    subjects=(
        ("furniture/soccer-ball", "brushed-metal", (224, 224), MAPS),
        ("furniture/grand-piano", "brushed-metal", (448, 448), ((16, 32),)),
    ),
    enough=0.3,
    gradients=("furniture/drill", "power drill", (224, 224), (16, 32)),
    factor=8,
    directions=(1, 2, 4, 8, 16, 32, 64),
    scenes=len(attack_runs.SCENES),
    steps=60,
    seeds=1,
    zoo={"steps": 40},
)
QUICK = Extent(
    subjects=(("furniture/soccer-ball", "brushed-metal", (64, 64), ((4, 8), (16, 32))),),
    enough=0.02,
    gradients=("furniture/soccer-ball", "soccer ball", (64, 64), (8, 16)),
    factor=8,
    directions=(1, 4, 16),
    scenes=1,
    steps=5,
    seeds=1,
    zoo={"steps": 2, "delta": 1e-2},
    quick=True,
)


def about(extent: Extent) -> str:
    """What a measurement of this extent is, so that one that was stopped is continued only by the same."""
    return f"{extent}; {backend()}; {versions(*PACKAGES)}"


@dataclass(frozen=True)
class Found:
    """Everything that was measured, and what follows from it."""

    independent: list[IndependentRow] = field(default_factory=list)
    shading: list[ShadingRow] = field(default_factory=list)
    cannot_run: list[CannotRunRow] = field(default_factory=list)
    maps: list[MapRow] = field(default_factory=list)
    shadows: list[ShadowRow] = field(default_factory=list)
    orders: list[OrderRow] = field(default_factory=list)
    signs: list[SignRow] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    gradients: list[GradientRow] = field(default_factory=list)
    attacks: list[AttackRow] = field(default_factory=list)
    success: list[SuccessRow] = field(default_factory=list)


def collect(extent: Extent, progress: Progress | None = None) -> Found:
    """Measures all parts, or takes from `progress` what it has."""
    progress = progress or Progress()
    found = Found()
    shading(extent, progress, found)
    mesh, material, size, maps = extent.subjects[0]
    smooth = progress.rows(
        "orders: smooth",
        OrderRow,
        lambda: list(smooth_orders(subject(mesh, material, size, maps[0]).surface.angles)),
    )
    found.orders.extend([*smooth, *shading_orders(found.shading)])
    found.maps.extend(progress.rows("maps", MapRow, lambda: list(map_resolution.rows(mesh, size))))
    found.shadows.extend(progress.rows("shadows", ShadowRow, lambda: list(shadow_resolution.rows(size, extent.enough))))
    found.signs.extend(progress.rows("signs", SignRow, lambda: list(network_signs.rows(*extent.gradients))))
    estimates(extent, progress, found)
    found.attacks.extend(attacks(extent, progress))
    found.success.extend(success_rows(found.attacks))
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


def _measured(scene: Scene, possible: list[ShadingMethod], extent: Extent) -> list[ShadingRow]:
    of = subject(*scene)
    truths = {groups: truth(of, groups) for groups in dict.fromkeys(method.groups for method in possible)}
    return [row(method, of, truths[method.groups], extent.enough) for method in possible]


def _independent(scene: Scene) -> list[IndependentRow]:
    return list(comparisons(subject(*scene)))


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


def attacks(extent: Extent, progress: Progress) -> list[AttackRow]:
    """Every attack."""
    found = []
    for case in attack_runs.cases(extent.scenes, extent.steps, extent.seeds, extent.zoo):
        settings = case.attack
        groups = " ".join(settings.groups)
        name = f"{settings.method}: {case.scene}, {groups}, tolerance {case.tolerance}, seed {case.seed}"
        found += progress.rows(name, AttackRow, partial(_attacked, case))
    return found


def _attacked(case: attack_runs.Case) -> list[AttackRow]:
    return [attack_runs.attack(case)]
