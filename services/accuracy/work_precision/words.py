"""Sentences drawn from the rows of the work-precision report, and what it does not measure."""

from collections.abc import Iterator, Sequence

from services.accuracy.work_precision.attack_runs import Attacked
from services.accuracy.work_precision.shading_methods import ShadingRow
from services.accuracy.work_precision.slopes import PICTURE, SlopeRow

EXACTLY = 1e-12
"""Largest error of a plan that estimates none: its sum is the reference's."""

OMISSIONS = (
    "Shading is measured for one object of one material at a time, on this machine's processor; not on a GPU.",
    "Seconds of shading leave out the network, the rasterised geometry and making the plan, which a job does once.",
    "A table's own values, filled once where neither light nor material is attacked, are not counted as evaluations.",
    "float16 is not tried: its largest number is 65,504, and exponentials of lobes pass it. bfloat16 is a row.",
    "Random directions are tried with one step and on weighted pictures, not on the network.",
    "Parameters of the torch renderer are handed on in float32, as an attack does: with a step below 1e-5 a number of "
    "the material may stay what it is, and its slope is 0.",
    "The function that is derived is a weighted sum with smooth random weights; rougher weights make 8-bit differences "
    "and those of silhouettes worse.",
    "Success is of a few scenes and seeds: enough for the cost of a step and the order of the methods, not for a rate.",
    "The viewer is far away, as is the default; one at the camera (`viewer: perspective`) is summed pixel by pixel.",
    "Where light or pose moves nothing but a shadow nothing is seen: the renderers draw no shadows.",
)


def findings(shading: Sequence[ShadingRow], slopes: Sequence[SlopeRow], attacks: Sequence[Attacked]) -> Iterator[str]:
    """What the rows come to, one sentence after another."""
    yield from _of_shading(shading)
    yield from _of_slopes(slopes)
    yield from _of_attacks(attacks)


def _of_shading(rows: Sequence[ShadingRow]) -> Iterator[str]:
    for subject in dict.fromkeys((row.mesh, row.map) for row in rows):
        own = [row for row in rows if (row.mesh, row.map) == subject and row.both is not None]
        sums = {(row.dtype, row.kernel): row for row in own if row.method == "sum"}
        plans = {row.groups: row for row in own if row.tolerance == 1e-3}
        whole = max(plans, key=len)
        times = ", ".join(
            f"{(sums['float32', 'native'].both or 0) / (row.both or 1):.1f} for {' and '.join(groups)}"
            for groups, row in plans.items()
        )
        yield (
            f"{subject[0]}, map {subject[1][0]}×{subject[1][1]}: what the plan picks at 1e-3 is off by "
            f"{plans[whole].largest:.1e} and is so many times faster than the sum in float32, itself off by "
            f"{sums['float32', 'native'].largest:.1e}: {times}."
        )
    promised = [(r, r.largest, r.estimate) for r in rows if r.largest is not None and r.estimate is not None]
    beyond = [one for one in promised if one[1] > max(one[2], EXACTLY)]
    lost = sum(row.note.startswith("misses") for row, _, _ in promised)
    yield (
        f"The measured error is within the plan's estimate in {len(promised) - len(beyond)} of {len(promised)} plans, "
        f"and beyond the tolerance in {lost}."
    )
    for row, largest, estimate in beyond:
        yield (
            f"Beyond the estimate: {row.mesh}, {' and '.join(row.groups)}, tolerance {row.tolerance}: {largest:.1e} "
            f"where {estimate:.1e} was estimated."
        )
    missed = sum(bool(row.note) for row in rows)
    yield f"{missed} of {len(rows)} ways missed 1e-3 or the tolerance they were given, or could not run; each says so."


def _of_slopes(rows: Sequence[SlopeRow]) -> Iterator[str]:
    one_by_one = [row for row in rows if row.directions is None and row.estimator == "central"]
    for picture in dict.fromkeys(row.picture for row in one_by_one):
        best: dict[tuple[str, str, str, int | None], SlopeRow] = {}
        for row in one_by_one:
            key = row.renderer, row.of, row.group, row.samples
            if row.picture == picture and row.samples in (None, 4) and (key not in best or row.error < best[key].error):
                best[key] = row
        words = ", ".join(
            f"{row.group}{'' if row.of == PICTURE else ' of the network'} "
            + (f"{max(row.error, row.floor):.0e} at {row.delta:.0e}" if not row.note else "wrong at every δ")
            for row in best.values()
        )
        yield f"Central differences of {picture} pictures, each at its best δ, are off by: {words}."
    wrong = [row for row in one_by_one if row.delta == 1e-4 and row.picture == "8 bit"]
    yield (
        f"At δ = 1e-4, the paper's, differences of 8-bit pictures are more than half wrong in "
        f"{sum(bool(row.note) for row in wrong)} of {len(wrong)} cases."
    )


def _of_attacks(rows: Sequence[Attacked]) -> Iterator[str]:
    for renderer, groups in dict.fromkeys((row.renderer, row.groups) for row in rows):
        own = [row for row in rows if (row.renderer, row.groups) == (renderer, groups) and row.outcome[0] != "w"]
        by = {t: [row for row in own if row.tolerance == t] for t in dict.fromkeys(row.tolerance for row in own)}
        for tolerance, some in by.items():
            won = sum(row.outcome == "verified" for row in some)
            pace = sum(row.seconds for row in some) / max(1, sum(row.steps for row in some))
            yield (
                f"{some[0].method} on {renderer} {' and '.join(groups)}, tolerance {tolerance}: {won} of {len(some)} "
                f"verified, {pace:.2g} s a step."
            )
        if "exact" in by and len(by) > 1:
            pairs = [(a, b) for a in by["exact"] for b in own if b.tolerance != "exact" and b.scene == a.scene]
            same = sum((a.outcome, a.steps) == (b.outcome, b.steps) for a, b in pairs)
            yield f"There, exact and approximate attacks end alike, at the same step, in {same} of {len(pairs)}."
