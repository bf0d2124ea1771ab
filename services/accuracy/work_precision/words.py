"""Conclusions drawn from the rows of the work-precision report, and what it does not measure."""

from collections.abc import Iterator

from services.accuracy.work_precision.clevr_subject import SCENE
from services.accuracy.work_precision.collect import Found
from services.accuracy.work_precision.gradients import IMAGE, GradientRow
from services.accuracy.work_precision.shading_rows import ShadingRow
from services.accuracy.work_precision.success import Interval, SuccessRow

EXACTLY = 1e-12
"""Largest error of a plan that estimates none: its sum is the reference's."""
DEFAULT = 1e-3
"""The tolerance of a job that names none."""
DEFAULT_MAP = (16, 32)
PAPER_STEP = 1e-4

OMISSIONS = (
    "Shading is measured for one object of one material at a time, on this machine's processor; not on a GPU.",
    "Seconds of shading leave out the network, the rasterised geometry and making the plan, which a job does once.",
    "A table's own values, filled once where neither light nor material is attacked, are not counted as evaluations.",
    "float16 is not tried: its largest number is 65,504, and exponentials of lobes pass it. bfloat16 is a row.",
    "Random directions are tried with one step and on weighted images, not on the network.",
    "The torch renderer takes its parameters in float32, as an attack does: with a step below 1e-5 a coordinate of "
    "the material may stay what it is, and its difference is 0.",
    "The function whose gradient is taken is a weighted sum with smooth random weights; rougher weights make 8-bit "
    "differences and those of silhouettes worse.",
    "The independent program takes base colours and coverage from the rasterised geometry.",
    "Mitsuba has no material of this model, so it cannot be a second reference; docs/benchmarks.md compares its speed "
    "on a problem of the same size.",
    "The viewer is far away, as is the default; one at the camera (`viewer: perspective`) is summed pixel by pixel.",
    "Gradients and attacks are measured without a floor and shadows.",
)


def conclusions(found: Found) -> Iterator[str]:
    """What the rows come to, most important first."""
    yield from _of_success(found.success)
    yield from _of_plans(found)
    yield from _of_maps(found)
    yield from _of_scenes(found)
    yield from _of_signs(found)
    yield from _of_references(found)
    yield from _of_orders(found)
    yield from _of_gradients(found.gradients)


def named(groups: tuple[str, ...]) -> str:
    """A set of groups in a sentence."""
    return " and ".join(groups) if len(groups) < 3 else f"all {len(groups)} groups"


def interval(of: Interval, digits: str = "g") -> str:
    """A median with its interval; ">" stands for more than the budget."""

    def one(value: float | None) -> str:
        return "> budget" if value is None else f"{value:.3{digits}}"

    return f"{one(of.median)} [{one(of.low)}, {one(of.high)}]"


def _of_success(rows: list[SuccessRow]) -> Iterator[str]:
    for row in rows:
        if row.tolerance != DEFAULT and row.renderer != "image":
            continue
        rate = f"{row.verified} of {row.attacks} ({row.rate_low:.0%} to {row.rate_high:.0%})"
        work = f"median {interval(row.queries)} queries, {interval(row.seconds)} seconds"
        if row.queries.median is None:
            work = f"more than half hold for the whole budget of {row.max_steps} steps"
        yield f"{row.method} on {row.renderer}, {named(row.groups)}: a verified adversary in {rate}; {work}."
    by = {row.tolerance: row for row in rows if row.renderer == "torch" and len(row.groups) == 3}
    if "exact" in by and DEFAULT in by:
        exact, fast = by["exact"], by[DEFAULT]
        yield (
            f"On all torch groups a step costs {fast.seconds_per_step:.2g} s within {DEFAULT:g} and "
            f"{exact.seconds_per_step:.2g} s exactly; {fast.verified} and {exact.verified} of {fast.attacks} attacks "
            "are verified."
        )


def _of_plans(found: Found) -> Iterator[str]:
    for subject in dict.fromkeys((row.mesh, row.map) for row in found.shading):
        own = [row for row in found.shading if (row.mesh, row.map) == subject and row.both is not None]
        sums = {(row.dtype, row.kernel): row for row in own if row.method == "sum"}
        plain, plans = sums["float32", "native"], {row.groups: row for row in own if row.tolerance == DEFAULT}
        whole = max(plans, key=len)
        times = ", ".join(f"{_ratio(plain, row):.1f} for {named(groups)}" for groups, row in plans.items())
        yield (
            f"{subject[0]}, map {subject[1][0]}×{subject[1][1]}: the plan within {DEFAULT:g} is off by "
            f"{plans[whole].largest:.1e}. The float32 sum, off by {plain.largest:.1e}, takes longer by a factor of "
            f"{times} (medians)."
        )
    if not found.shading:
        return
    promised = [(r, r.largest, r.estimate) for r in found.shading if r.largest is not None and r.estimate is not None]
    beyond = [one for one in promised if one[1] > max(one[2], EXACTLY)]
    lost = sum(row.note.startswith("misses") for row, _, _ in promised)
    yield (
        f"The measured error is within the plan's estimate in {len(promised) - len(beyond)} of {len(promised)} plans, "
        f"and beyond the tolerance in {lost}."
    )
    for row, largest, estimate in beyond:
        yield (
            f"Beyond the estimate: {row.mesh}, {named(row.groups)}, tolerance {row.tolerance}: {largest:.1e} where "
            f"{estimate:.1e} was estimated."
        )


def _ratio(slow: ShadingRow, fast: ShadingRow) -> float:
    assert slow.both is not None
    assert fast.both is not None
    return slow.both.median / fast.both.median


def _of_signs(found: Found) -> Iterator[str]:
    for group in dict.fromkeys(row.group for row in found.signs):
        own = {(row.tolerance, row.image): row for row in found.signs if row.group == group}
        plan, rounded = own[DEFAULT, "unrounded"], own["exact", "8 bit"]
        yield (
            f"Of the {plan.coordinates:,} signs that FGSM takes of {group} through the network, a plan within "
            f"{DEFAULT:g} gives {plan.wrong_signs:.1%} wrong ({plan.wrong_weight:.2%} of the gradient's absolute sum). "
            f"Taking the network's gradient at the 8-bit image, as the loop does, gives {rounded.wrong_signs:.1%} "
            f"wrong ({rounded.wrong_weight:.2%}) even with exact shading."
        )


def _of_maps(found: Found) -> Iterator[str]:
    own = [row for row in found.maps if row.map == DEFAULT_MAP]
    if own:
        words = ", ".join(f"{row.largest:.2g} ({row.material})" for row in own)
        yield (
            f"The largest error of all is the map's: averaged to {own[0].map[0]}×{own[0].map[1]} texels instead of "
            f"{own[0].reference[0]}×{own[0].reference[1]}, exact images differ by up to {words}."
        )


def _of_scenes(found: Found) -> Iterator[str]:
    for renderer in dict.fromkeys(row.renderer for row in found.scenes):
        own = [row for row in found.scenes if (row.renderer, row.tolerance) == (renderer, DEFAULT)]
        times = ", ".join(f"{row.seconds:.2g} ({row.scene})" for row in own)
        yield (
            f"{SCENE}, {renderer}: the plan within {DEFAULT:g} takes {times} seconds an image, each with one more "
            f"option, and is off by {max(row.mean for row in own):.1e} at most in the mean over covered pixels."
        )


def _of_references(found: Found) -> Iterator[str]:
    def worst(words: str) -> float:
        return max(row.largest for row in found.independent if words in row.what)

    if found.independent:
        yield (
            "The float64 shader, which is the reference of all shading errors here, differs from an independent "
            f"program in 80 bits by at most {worst('moved'):.1e} in images and {worst('derivative'):.1e} in "
            f"derivatives; with normals from rays through the triangles, by {worst('own values'):.1e} in images."
        )


def _of_orders(found: Found) -> Iterator[str]:
    smooth = [row for row in found.orders if row.map is None and row.error == "rms"]
    real = [row for row in found.orders if row.map is not None and row.error == "rms"]
    for row in smooth:
        yield (
            f"Table lookup of a smooth function converges with order {row.order:.2f} ± {row.standard_error:.2f} "
            f"(stated: {row.stated})."
        )
    if real:
        low, high = (pick(real, key=lambda row: row.order) for pick in (min, max))
        yield (
            f"Tables of real radiance converge more slowly, as every texel has an edge at the horizon: order "
            f"{low.order:.2f} ± {low.standard_error:.2f} to {high.order:.2f} ± {high.standard_error:.2f}, by map and "
            "by texels summed per pixel."
        )


def _of_gradients(rows: list[GradientRow]) -> Iterator[str]:
    one_by_one = [row for row in rows if row.directions is None and row.estimator == "central"]
    for image in dict.fromkeys(row.image for row in one_by_one):
        best: dict[tuple[str, str, str], GradientRow] = {}
        for row in one_by_one:
            key = row.renderer, row.of, row.group
            if row.image == image and row.samples in (None, 4) and (key not in best or row.error < best[key].error):
                best[key] = row
        words = ", ".join(
            f"{row.group}{'' if row.of == IMAGE else ' of the network'} "
            + (f"{max(row.error, row.floor):.0e} at {row.delta:.0e}" if not row.note else "wrong at every δ")
            for row in best.values()
        )
        yield f"Central differences of {image} images, each at its best δ, have relative errors of: {words}."
    if not rows:
        return
    wrong = [row for row in one_by_one if row.delta == PAPER_STEP and row.image == "8 bit"]
    yield (
        f"At δ = {PAPER_STEP:.0e}, the paper's, differences of 8-bit images are more than half wrong in "
        f"{sum(bool(row.note) for row in wrong)} of {len(wrong)} cases."
    )
