"""The tables of the work-precision report's page."""

from collections.abc import Iterator, Sequence

from services.accuracy.work_precision.attack_runs import AttackRow
from services.accuracy.work_precision.convergence import OrderRow
from services.accuracy.work_precision.gradients import DELTAS, GradientRow, Reference
from services.accuracy.work_precision.independent_check import IndependentRow
from services.accuracy.work_precision.network_signs import SignRow
from services.accuracy.work_precision.shading_rows import CannotRunRow, ShadingRow
from services.accuracy.work_precision.success import SuccessRow
from services.accuracy.work_precision.table_cells import brief, grid, quartiles, small, table
from services.accuracy.work_precision.words import interval

SHADING = (
    *("method", "attacked", "type", "rows>", "per-pixel texels>", "evaluations>", "max>", "rms>", "gradients"),
    *("wrong signs", "by weight", "image s>", "and gradient s>", "note"),
)
RUNS = (
    *("scene", "method", "renderer", "attacked", "tolerance>", "seed>", "outcome", "steps>", "queries>", "seconds>"),
    "p>",
)


def success(rows: Sequence[SuccessRow]) -> Iterator[str]:
    """Rates and medians of whole attacks."""
    yield from ("## Work to a verified adversary", "")
    yield "Medians with 95 % bootstrap intervals over the scenes; attacks that held count as more work than the budget."
    yield "Rates with Wilson's 95 % intervals. *Per success*: the work of all attacks, divided by the successes."
    yield ""
    yield from table(
        (
            *("method", "renderer", "attacked", "tolerance>", "verified>", "rate>", "95 %>", "queries", "seconds"),
            *("queries per success>", "seconds per success>", "s a step>", "budget>"),
        ),
        [
            [
                *(row.method, row.renderer, ", ".join(row.groups), small(row.tolerance)),
                *(f"{row.verified} of {row.attacks}", f"{row.rate:.0%}", f"{row.rate_low:.0%}–{row.rate_high:.0%}"),
                *(interval(row.queries), interval(row.seconds)),
                *(brief(row.queries_per_success), brief(row.seconds_per_success)),
                *(brief(row.seconds_per_step), f"{row.max_steps} steps"),
            ]
            for row in rows
        ],
    )


def independent(rows: Sequence[IndependentRow]) -> Iterator[str]:
    """The float64 shader beside the independent program."""
    yield from ("## The reference", "")
    yield "Errors of shading are against the float64 sum over all directions and lobes. An independent program in"
    yield "numpy's 80-bit numbers, without code of the renderer, evaluates the formulas of docs/materials.md on some of"
    yield "the pixels; its derivatives are complex steps. The differences, of displayed values in [0,1]:"
    yield ""
    yield from table(
        ("mesh", "material", "map", "compared", "pixels>", "largest>", "rms>"),
        [
            [
                *(row.mesh, row.material, grid(row.map), row.what, str(row.pixels)),
                *(small(row.largest), small(row.rms)),
            ]
            for row in rows
        ],
    )


def orders(rows: Sequence[OrderRow]) -> Iterator[str]:
    """Observed orders of convergence."""
    yield from ("## Orders of convergence of tables", "")
    yield "Error ∝ (spacing of nodes)^order: least squares of logarithms, with the slope's standard error. The stated"
    yield "orders are those of Catmull-Rom interpolation of smooth functions. Errors near rounding are not in a fit."
    yield ""
    yield from table(
        ("of", "type", "map", "per-pixel texels>", "error", "stated>", "observed>", "rows of nodes"),
        [
            [
                *(row.what, row.dtype, "" if row.map is None else grid(row.map)),
                *("" if row.per_pixel_texels is None else str(row.per_pixel_texels), row.error, str(row.stated)),
                *(f"{row.order:.2f} ± {row.standard_error:.2f}", f"{row.first_rows} to {row.last_rows} ({row.points})"),
            ]
            for row in rows
        ],
    )


def signs(rows: Sequence[SignRow]) -> Iterator[str]:
    """Signs of gradients through the network."""
    yield from ("## Signs that FGSM takes", "")
    yield "Of all coordinates of the log-odds' gradient, against float64 throughout, at the unperturbed scene. By"
    yield "weight: the part w of the gradient's absolute sum that they hold; a step by signs keeps 1 − 2w of its gain."
    yield ""
    yield from table(
        ("mesh", "group", "tolerance>", "network", "its image", "coordinates>", "wrong signs>", "by weight>"),
        [
            [
                *(row.mesh, row.group, small(row.tolerance), row.network, row.image, f"{row.coordinates:,}"),
                *(f"{row.wrong_signs:.2%}", f"{row.wrong_weight:.3%}"),
            ]
            for row in rows
        ],
    )


def shading(rows: Sequence[ShadingRow], cannot_run: Sequence[CannotRunRow]) -> Iterator[str]:
    """Methods of shading, one table for each subject."""
    yield from ("## Methods of shading", "")
    yield from (
        "Errors are of displayed values in [0,1] at the object's pixels, against the sum over all directions and",
        "lobes in float64, some way into an attack. *sum*: over every direction and lobe at every pixel; *table*: over",
        "normals, with the *per-pixel texels* summed beside it; *fixed table*: filled once; *transport*: a product",
        "with kept factors; *plan*: what the renderer picks for a tolerance. Gradients are relative errors (L2) for",
        "normals (N), illumination (I), material (M). *Wrong signs*: share of all coordinates; *by weight*: the part",
        "of the gradient's absolute sum that they hold. Evaluations are lobe values or products of one image. A note",
        "says what missed.",
    )
    for subject in dict.fromkeys((row.mesh, row.material, row.size, row.map) for row in rows):
        mesh, material, size, texels = subject
        own = [row for row in rows if (row.mesh, row.material, row.size, row.map) == subject]
        pixels = f"{own[0].pixels:,} pixels"
        yield from ("", f"### {mesh}, {material}, {size[0]}×{size[1]}, map {grid(texels)}, {pixels}", "")
        yield from table(SHADING, map(_shading_row, own))
        for left_out in cannot_run:
            if (left_out.mesh, left_out.map) == (mesh, texels):
                yield from ("", f"{left_out.methods} methods cannot run here: {left_out.why}.")


def _shading_row(row: ShadingRow) -> list[str]:
    method = row.method if row.tolerance is None else f"plan, {small(row.tolerance)}"
    return [
        method if row.kernel == "native" else f"{method}, in torch",
        "all" if len(row.groups) == 3 else ", ".join(row.groups),
        row.dtype,
        str(row.rows or ""),
        str(row.per_pixel_texels or ""),
        "" if row.evaluations is None else f"{row.evaluations:.1e}",
        small(row.largest),
        small(row.rms),
        _by_group({group: small(error) for group, error in row.gradient.items()}),
        _by_group({group: f"{share:.2%}" for group, share in row.wrong_signs.items()}),
        _by_group({group: f"{share:.3%}" for group, share in row.wrong_weight.items()}),
        quartiles(row.forward),
        quartiles(row.both),
        row.note,
    ]


def _by_group(values: dict[str, str]) -> str:
    return ", ".join(f"{group[0].upper()} {value}" for group, value in values.items())


def gradients(rows: Sequence[GradientRow], references: Sequence[Reference]) -> Iterator[str]:
    """Estimates of gradients from values alone."""
    yield from ("## Estimates of gradients", "")
    yield "Relative errors (L2) of gradients estimated from values of a function alone. δ is in the group's units. An"
    yield "error below the reference's uncertainty means nothing, and is shown as that. **Bold**: more than half wrong."
    yield ""
    yield from table(
        ("renderer", "group", "function", "samples>", "reference", "uncertainty>"),
        [[r.renderer, r.group, r.of, str(r.samples or ""), r.how, small(r.uncertainty)] for r in references],
    )
    keys = ("renderer", "group", "of", "samples", "image", "estimator", "evaluations")
    stepped = [row for row in rows if row.directions is None]
    yield from ("", "### Coordinate by coordinate", "")
    yield from table(
        [
            *("renderer", "group", "function", "samples>", "image", "difference", "evaluations>"),
            *(f"δ {delta:.0e}>" for delta in DELTAS),
        ],
        [[*(str(part or "") for part in key), *map(_error, own)] for key, own in _grouped(stepped, keys).items()],
    )
    yield from ("", "### Along random directions", "")
    yield "*Expected*, for n coordinates: √((n + 1) / directions), of the mean of exact derivatives along them."
    yield ""
    yield from table(
        (
            *("renderer", "group", "samples>", "image"),
            "coordinates>",
            "directions>",
            "evaluations>",
            "error>",
            "expected>",
        ),
        [
            [
                *(row.renderer, row.group, str(row.samples or ""), row.image, str(row.dimensions)),
                *(str(row.directions), str(row.evaluations), _error(row), f"{expected(row):.1e}"),
            ]
            for row in rows
            if row.directions is not None
        ],
    )


def expected(row: GradientRow) -> float:
    """Relative error of the mean of exact derivatives along the row's number of Gaussian directions."""
    return float(((row.dimensions + 1) / (row.directions or row.dimensions)) ** 0.5)


def attacks(rows: Sequence[AttackRow]) -> Iterator[str]:
    """Every attack."""
    yield from ("## Whole attacks", "")
    yield "On EfficientNet-Lite0, studio map of 16×32. *verified*: the exact image, saved in 8 bits, fools it."
    yield "Where an attack held, p is that of its last image. FGSM takes nothing from its seed."
    yield ""
    yield from table(
        RUNS,
        [
            [
                *(row.scene, row.method, row.renderer, ", ".join(row.groups), small(row.tolerance), str(row.seed)),
                *(row.outcome, f"{row.steps} of {row.max_steps}", str(row.queries), brief(row.seconds)),
                small(row.perceptibility),
            ]
            for row in rows
        ],
    )


def _grouped(rows: Sequence[GradientRow], keys: Sequence[str]) -> dict[tuple[object, ...], list[GradientRow]]:
    found: dict[tuple[object, ...], list[GradientRow]] = {}
    for row in rows:
        found.setdefault(tuple(getattr(row, key) for key in keys), []).append(row)
    return found


def _error(row: GradientRow) -> str:
    shown = f"< {row.floor:.1e}" if row.error < row.floor else small(row.error)
    return f"**{shown}**" if row.note else shown
