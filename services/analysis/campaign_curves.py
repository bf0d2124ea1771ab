"""Mean curves of a campaign against the steps of the attack (paper, appendix)."""

from collections.abc import Iterable, Sequence

from pydantic import BaseModel, ConfigDict, Field

MEASURES = ("loss", "advantage", "distance")


class Curves(BaseModel):
    """One attack's curves: a value for each step, from the trace."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    loss: list[float] = Field(description="probability of the label to leave, or 1 minus that of the label to reach")
    advantage: list[float] = Field(description="log-probability advantage of the right answer; below 0: fooled")
    distance: list[float] = Field(description="‖ΔY‖₂ of the image, RGB in [0,1]")


class MeanCurves(Curves):
    """The mean curves of all cases of a cell. A case that has ended keeps its last value, so all are in every mean."""

    target: str
    attack: str
    cases: int


def mean_curve(curves: Sequence[Sequence[float]]) -> list[float]:
    """The mean at each step over all curves; one that has ended keeps its last value. Curves without values count not.

    The result has as many values as the longest curve.
    """
    there = [curve for curve in curves if curve]
    longest = max(map(len, there), default=0)
    return [sum(curve[min(step, len(curve) - 1)] for curve in there) / len(there) for step in range(longest)]


def mean_curves(traced: Iterable[tuple[str, str, Curves]]) -> list[MeanCurves]:
    """The mean curves of each target and attack, from (target, attack, curves) of each case, in order of occurrence."""
    cells: dict[tuple[str, str], list[Curves]] = {}
    for target, attack, curves in traced:
        cells.setdefault((target, attack), []).append(curves)
    return [
        MeanCurves(
            target=target,
            attack=attack,
            cases=len(own),
            **{measure: mean_curve([getattr(one, measure) for one in own]) for measure in MEASURES},
        )
        for (target, attack), own in cells.items()
    ]
