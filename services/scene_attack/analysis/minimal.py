"""The minimal change: the smallest scale at which the stored perturbation still fools the network.

The perturbation is multiplied by a scale s in (0, 1], rendered exactly and rounded to 8 bits. Along this ray success
need not be monotone: a network that is fooled at s may hold at a larger s. So the ray is scanned first, and then the
boundary of the first scanned scale that fools is bisected. What lies between two scanned scales is not known.
"""

from collections.abc import Callable, Sequence

from scene_attack.analysis.attribution import Tick
from scene_attack.analysis.records import MinimalChange, MinimalRequest, RayPoint
from scene_attack.analysis.subsets import ScoredImage, scored
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.physical_change import PhysicalChange
from scene_attack.rendering.protocol import Parameters


def scan_and_bisect(fooled: Callable[[float], bool], scans: int, bisections: int) -> tuple[float | None, float]:
    """Returns the smallest scale found that fools, and the largest below it at which the network was seen to hold.

    `fooled` is asked at 1/scans, 2/scans, …, 1 and then at `bisections` scales between the first of these that fools
    and the one before it, so that the two results are 1/(scans · 2^bisections) apart. Scale 0, the original, counts as
    holding. Returns (None, 1) if no scanned scale fools.
    """
    fools = [fooled(k / scans) for k in range(1, scans + 1)]
    if True not in fools:
        return None, 1.0
    first = fools.index(True)
    low, high = first / scans, (first + 1) / scans
    for _ in range(bisections):
        middle = (low + high) / 2
        if fooled(middle):
            high = middle
        else:
            low = middle
    return high, low


def minimal_change(
    verifier: Verifier,
    goal: ResolvedGoal,
    perturbation: Parameters,
    original: ScoredImage,
    request: MinimalRequest,
    *,
    physical: Callable[[Parameters], list[PhysicalChange]],
    tick: Tick,
) -> MinimalChange:
    """Scans and bisects the ray of a perturbation; see `scan_and_bisect`.

    `original` is the unperturbed image; `physical` words a perturbation in degrees, centimetres and percent.
    """
    points: dict[float, RayPoint] = {}

    def fooled(scale: float) -> bool:
        tick(len(points), request.scans + request.bisections)
        image = scored(verifier, scaled(perturbation, scale))
        points[scale] = RayPoint(scale=scale, **image.judged(original, verifier.target.labels, goal))
        return points[scale].fooled

    scale, held = scan_and_bisect(fooled, request.scans, request.bisections)
    scan = [points[k / request.scans] for k in range(1, request.scans + 1)]
    return MinimalChange(
        smallest=None if scale is None else points[scale],
        holds_at=held,
        fools_from=_fools_from(scan),
        scan=scan,
        images=len(points),
        change=[] if scale is None else physical(scaled(perturbation, scale)),
        stored_change=physical(perturbation),
    )


def scaled(perturbation: Parameters, scale: float) -> Parameters:
    """The perturbation times `scale`; at 1 it is the perturbation itself, bit for bit."""
    return {group: value * scale for group, value in perturbation.items()}


def _fools_from(scan: Sequence[RayPoint]) -> float | None:
    """The smallest scanned scale from which on all scanned scales fool; None if the whole perturbation does not."""
    smallest = None
    for point in reversed(scan):
        if not point.fooled:
            break
        smallest = point.scale
    return smallest
