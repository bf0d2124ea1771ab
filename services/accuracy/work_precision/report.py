"""What error costs in time, as a page and as data."""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.work_precision.attack_runs import Attacked
from services.accuracy.work_precision.collect import Found
from services.accuracy.work_precision.shading_methods import ShadingRow
from services.accuracy.work_precision.slopes import DELTAS, Reference, SlopeRow
from services.accuracy.work_precision.words import OMISSIONS, findings
from services.versions import versions

NAME = "work-precision"
WAYS = (
    *("way", "attacked", "type", "rows>", "sharp>", "evaluations>", "max>", "rms>", "gradients", "signs>"),
    *("picture s>", "and gradient s>", "note"),
)
STEPPED = ("renderer", "group", "function", "samples>", "picture", "difference", "evaluations>")
RUNS = (
    *("scene", "method", "renderer", "attacked", "tolerance>", "seed>", "outcome", "steps>", "queries>", "seconds>"),
    "p>",
)


class Report(BaseModel):
    """Everything that `work-precision.json` says."""

    model_config = ConfigDict(extra="forbid")

    command: str
    seed: int = Field(description="of every random number but those of an attack, whose seed is in its row")
    versions: dict[str, str]
    backend: str
    shading: list[ShadingRow]
    references: list[Reference]
    slopes: list[SlopeRow]
    attacks: list[Attacked]


def report(found: Found, command: str) -> Report:
    """What was measured, with what is needed to measure it again."""
    return Report(
        command=command,
        seed=0,
        versions=versions(*PACKAGES, "matplotlib"),
        backend=backend(),
        shading=found.shading,
        references=found.references,
        slopes=found.slopes,
        attacks=found.attacks,
    )


def write(made: Report, folder: Path) -> None:
    """`work-precision.md`, `.json` and `.png` in the folder, which is made if need be."""
    from services.accuracy.work_precision.curves import draw  # matplotlib takes a second to import

    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.json").write_text(_json(made), "utf-8")
    (folder / f"{NAME}.md").write_text(markdown(made), "utf-8")
    draw(made.shading, made.slopes, made.attacks, folder / f"{NAME}.png")


def _json(made: Report) -> str:
    """One row to a line."""

    def text(value: object) -> str:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)

    def entry(value: object) -> str:
        return "[\n  " + ",\n  ".join(map(text, value)) + "\n ]" if isinstance(value, list) else text(value)

    data = made.model_dump(mode="json")
    return "{\n" + ",\n".join(f" {text(name)}: {entry(value)}" for name, value in data.items()) + "\n}\n"


def markdown(made: Report) -> str:
    """The page."""
    lines = ["# Error against run time", "", f"![Error against seconds, evaluations and steps]({NAME}.png)", ""]
    lines += [f"- {words}" for words in findings(made.shading, made.slopes, made.attacks)]
    lines += ["", *_shading(made.shading), "", *_slopes(made), "", *_attacks(made.attacks)]
    lines += ["", "## What is left out", "", *(f"- {words}" for words in OMISSIONS)]
    lines += ["", "## How to make this page again", "", "```sh", made.command, "```", ""]
    lines += [f"{made.backend}; " + ", ".join(f"{name} {number}" for name, number in made.versions.items()) + "."]
    lines += [f"Seed {made.seed}. Seconds are the shortest of several runs after one that warms up, on this machine."]
    return "\n".join(lines) + "\n"


def _shading(rows: Sequence[ShadingRow]) -> Iterator[str]:
    yield "## Ways of shading"
    yield ""
    yield from (
        "Errors are of displayed values in [0,1] at the object's pixels, against the sum over all directions and",
        "lobes in float64, some way into an attack. *sum*: over every direction and lobe at every pixel; *table*:",
        "over normals, with the *sharp* directions summed beside it; *fixed table*: filled once; *transport*: a",
        "product with kept factors; *plan*: what the renderer picks for a tolerance. *Signs*: share of the slopes",
        "above 5 % of the largest that have the right sign, in the worst group. Gradients are of normals (N),",
        "illumination (I), material (M). Evaluations are lobe values or products of one picture. A note says what",
        "missed or could not run.",
    )
    subjects = dict.fromkeys((row.mesh, row.material, row.size, row.map) for row in rows)
    for subject in subjects:
        mesh, material, size, texels = subject
        own = [row for row in rows if (row.mesh, row.material, row.size, row.map) == subject]
        yield ""
        yield f"### {mesh}, {material}, {size[0]}×{size[1]}, map {texels[0]}×{texels[1]}, {own[0].pixels:,} pixels"
        yield ""
        yield from _table(
            WAYS,
            map(_shading_row, own),
        )


def _shading_row(row: ShadingRow) -> list[str]:
    way = row.method if row.tolerance is None else f"plan, {_small(row.tolerance)}"
    return [
        way if row.kernel == "native" else f"{way}, in torch",
        "all" if len(row.groups) == 3 else ", ".join(row.groups),
        row.dtype,
        str(row.rows or ""),
        str(row.sharp or ""),
        "" if row.evaluations is None else f"{row.evaluations:.1e}",
        _small(row.largest),
        _small(row.rms),
        ", ".join(f"{group[0].upper()} {_small(error)}" for group, error in row.gradient.items()),
        f"{min(row.signs.values()):.3f}" if row.signs else "",
        _seconds(row.forward),
        _seconds(row.both),
        row.note,
    ]


def _slopes(made: Report) -> Iterator[str]:
    yield "## Estimates of gradients"
    yield ""
    yield "Relative errors (L2) of slopes estimated from values of a function alone. δ is in the group's units. An"
    yield "error below the reference's uncertainty means nothing, and is shown as that. **Bold**: more than half wrong."
    yield ""
    yield from _table(
        ("renderer", "group", "function", "samples>", "reference", "uncertainty>"),
        [[r.renderer, r.group, r.of, str(r.samples or ""), r.how, _small(r.uncertainty)] for r in made.references],
    )
    yield ""
    keys = ("renderer", "group", "of", "samples", "picture", "estimator", "evaluations")
    stepped = [row for row in made.slopes if row.directions is None]
    steps = [f"δ {delta:.0e}>" for delta in DELTAS]
    yield "### Coordinate by coordinate"
    yield ""
    yield from _table(
        [*STEPPED, *steps],
        [[*(str(part or "") for part in key), *map(_error, own)] for key, own in _grouped(stepped, keys).items()],
    )
    yield ""
    yield "### Along random directions"
    yield ""
    yield "*Expected*, of n numbers: √((n + 1) / directions), what the mean of exact slopes along Gaussian ones has."
    yield ""
    yield from _table(
        ("renderer", "group", "samples>", "picture", "numbers>", "directions>", "evaluations>", "error>", "expected>"),
        [
            [
                *(row.renderer, row.group, str(row.samples or ""), row.picture, str(row.dimensions)),
                *(str(row.directions), str(row.evaluations), _error(row), f"{expected(row):.1e}"),
            ]
            for row in made.slopes
            if row.directions is not None
        ],
    )


def expected(row: SlopeRow) -> float:
    """Relative error of the mean of exact slopes along so many Gaussian directions, of so many numbers."""
    return float(((row.dimensions + 1) / (row.directions or row.dimensions)) ** 0.5)


def _grouped(rows: Sequence[SlopeRow], keys: Sequence[str]) -> dict[tuple[object, ...], list[SlopeRow]]:
    found: dict[tuple[object, ...], list[SlopeRow]] = {}
    for row in rows:
        found.setdefault(tuple(getattr(row, key) for key in keys), []).append(row)
    return found


def _error(row: SlopeRow) -> str:
    shown = f"< {row.floor:.1e}" if row.error < row.floor else _small(row.error)
    return f"**{shown}**" if row.note else shown


def _attacks(rows: Sequence[Attacked]) -> Iterator[str]:
    yield "## Whole attacks"
    yield ""
    yield "On EfficientNet-Lite0, studio map of 16×32. *verified*: the exact picture, saved in 8 bits, fools it."
    yield "Where an attack held, p is that of its last picture. FGSM takes nothing from its seed."
    yield ""
    yield from _table(
        RUNS,
        [
            [
                *(row.scene, row.method, row.renderer, ", ".join(row.groups), _small(row.tolerance), str(row.seed)),
                *(row.outcome, f"{row.steps} of {row.most}", str(row.queries), _seconds(row.seconds)),
                _small(row.perceptibility),
            ]
            for row in rows
        ],
    )


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Columns whose heading ends in ">" are aligned to the right."""
    yield "| " + " | ".join(column.removesuffix(">") for column in columns) + " |"
    yield "|" + "|".join("---:" if column.endswith(">") else "---" for column in columns) + "|"
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |"


def _small(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return f"{value:.1e}" if value else "0"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"
