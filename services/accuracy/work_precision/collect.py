"""Error against run time: ways of shading, estimates of gradients, whole attacks."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from services.accuracy.work_precision import attack_runs, shading_methods, slopes_pyrender, slopes_torch
from services.accuracy.work_precision.attack_runs import Attacked
from services.accuracy.work_precision.shading_methods import ShadingRow, Truth
from services.accuracy.work_precision.shading_subject import subject
from services.accuracy.work_precision.slopes import Objective, Reference, SlopeRow, along_directions, differences

Told = Callable[[str], None]


@dataclass(frozen=True)
class Extent:
    """How much is compared.

    subjects: mesh, material, size of the picture and sizes of maps that are shaded; enough: seconds for each time that
    is taken. slopes: mesh, label, size of picture and of map that are derived; factor: of pixels a side in the
    references of poses; directions: counts of random ones. scenes, steps and seeds of attacks; zoo: its settings.
    """

    subjects: tuple[tuple[str, str, tuple[int, int], tuple[tuple[int, int], ...]], ...]
    enough: float
    slopes: tuple[str, str, tuple[int, int], tuple[int, int]]
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
        ("furniture/grand-piano", "glossy-paint", (448, 448), ((16, 32),)),
    ),
    enough=0.5,
    slopes=("furniture/drill", "power drill", (224, 224), (16, 32)),
    factor=8,
    directions=(1, 2, 4, 8, 16, 32, 64),
    scenes=3,
    steps=60,
    seeds=2,
    zoo={"steps": 40},
)
QUICK = Extent(
    subjects=(("furniture/soccer-ball", "brushed-metal", (64, 64), ((4, 8), (16, 32))),),
    enough=0.02,
    slopes=("furniture/soccer-ball", "soccer ball", (64, 64), (8, 16)),
    factor=8,
    directions=(1, 4, 16),
    scenes=1,
    steps=5,
    seeds=1,
    zoo={"steps": 2, "delta": 1e-2},
    quick=True,
)


@dataclass(frozen=True)
class Found:
    """Everything that was measured."""

    shading: list[ShadingRow] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    slopes: list[SlopeRow] = field(default_factory=list)
    attacks: list[Attacked] = field(default_factory=list)


def collect(extent: Extent, told: Told = lambda _: None) -> Found:
    """Measures all three parts; `told` hears what comes next."""
    found = Found(shading=list(shading(extent, told)))
    for objective in objectives(extent):
        told(f"slopes of {objective.of}: {objective.renderer} {objective.group}")
        found.references.append(objective.reference)
        found.slopes.extend(slopes(objective, extent))
    found.attacks.extend(attacks(extent, told))
    return found


def shading(extent: Extent, told: Told = lambda _: None) -> Iterator[ShadingRow]:
    """Every way of shading, for every subject and size of its map."""
    for mesh, material, size, maps in extent.subjects:
        for texels in maps:
            of = subject(mesh, material, size, texels)
            truths: dict[tuple[str, ...], Truth] = {}
            for way in shading_methods.ways(extent.quick):
                told(f"shading: {mesh}, map {texels[0]}×{texels[1]}, {way.method} {way.dtype} {way.rows or ''}".strip())
                if way.groups not in truths:
                    truths[way.groups] = shading_methods.truth(of, way.groups)
                yield shading_methods.row(way, of, truths[way.groups], extent.enough)


def objectives(extent: Extent) -> Iterator[Objective]:
    """Every function whose gradient is estimated."""
    mesh, label, size, texels = extent.slopes
    yield from slopes_torch.objectives(mesh, label, size, texels)
    yield from slopes_pyrender.objectives(mesh, size, extent.factor)


def slopes(of: Objective, extent: Extent) -> Iterator[SlopeRow]:
    """Every estimate of one gradient; random directions are tried on pictures only, as the network costs too much."""
    yield from differences(of)
    if of.of != slopes_torch.ODDS:
        yield from along_directions(of, extent.directions)


def attacks(extent: Extent, told: Told = lambda _: None) -> Iterator[Attacked]:
    """Every attack."""
    for case in attack_runs.cases(extent.scenes, extent.steps, extent.seeds, extent.zoo):
        settings = case.attack
        told(f"{settings.method}: {case.scene}, {' '.join(settings.groups)}, tolerance {case.tolerance}")
        yield attack_runs.attack(case)
