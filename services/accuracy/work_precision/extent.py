"""How much the work-precision report compares: in full, and quickly."""

from dataclasses import dataclass

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.work_precision import attack_runs
from services.versions import versions


@dataclass(frozen=True)
class Extent:
    """How much is compared.

    subjects: mesh, material, size of the image and sizes of maps that are shaded; enough: seconds for each time that
    is taken. gradients: mesh, label, size of image and of map whose gradients are estimated; scene: size of the image
    of a CLEVR-style scene; factor: pixels a side in the references of poses; directions: counts of random ones.
    scenes, steps and seeds of attacks; zoo: its settings.
    """

    subjects: tuple[tuple[str, str, tuple[int, int], tuple[tuple[int, int], ...]], ...]
    enough: float
    gradients: tuple[str, str, tuple[int, int], tuple[int, int]]
    scene: tuple[int, int]
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
    scene=(240, 320),
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
    scene=(48, 64),
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
