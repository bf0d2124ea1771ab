"""Error against run time: extent of the measurements, their runner, and the report as a page, a CSV and JSON."""

import csv
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.tables import Row, small, table
from services.accuracy.work_precision import attacks as attack_runs
from services.accuracy.work_precision import scene_options, shading
from services.accuracy.work_precision.attacks import AttackRow, Interval, SignRow, SuccessRow, success_rows
from services.accuracy.work_precision.scene_options import MapRow, SceneRow, ShadowRow
from services.accuracy.work_precision.shading import GROUPS, ShadingRow
from services.process import versions

NAME = "work-precision"
DEFAULT = 1e-3
"""The tolerance of a job that names none."""
DEFAULT_MAP = (16, 32)
EXACTLY = 1e-12
"""Largest error of a plan that estimates none: its sum is the reference's."""


# What is measured


@dataclass(frozen=True)
class Extent:
    """The extent of the measurements.

    subjects: mesh, material, size of the image and sizes of maps that are shaded; enough: seconds for each time that
    is taken. signs: mesh, label, size of image and of map whose gradients go through the network; scene: size of the
    image of a CLEVR-style scene. scenes and steps of attacks; zoo: its settings.
    """

    subjects: tuple[tuple[str, str, tuple[int, int], tuple[tuple[int, int], ...]], ...]
    enough: float
    signs: tuple[str, str, tuple[int, int], tuple[int, int]]
    scene: tuple[int, int]
    scenes: int
    steps: int
    zoo: dict[str, object]


FULL = Extent(
    subjects=(
        ("furniture/soccer-ball", "brushed-metal", (224, 224), ((4, 8), (8, 16), (16, 32), (32, 64))),
        ("furniture/grand-piano", "glossy-paint", (448, 448), ((16, 32),)),
    ),
    enough=0.3,
    signs=("furniture/drill", "power drill", (224, 224), (16, 32)),
    scene=(240, 320),
    scenes=len(attack_runs.SCENES),
    steps=60,
    zoo={"steps": 40},
)
QUICK = Extent(
    subjects=(("furniture/soccer-ball", "brushed-metal", (64, 64), ((4, 8), (16, 32))),),
    enough=0.02,
    signs=("furniture/soccer-ball", "soccer ball", (64, 64), (8, 16)),
    scene=(48, 64),
    scenes=1,
    steps=5,
    zoo={"steps": 2, "delta": 1e-2},
)


class Measurement(BaseModel):
    """Date, command and machine with which the rows of a part were measured."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    when: str = Field(description="UTC, when the measurement ended")
    command: str
    seed: int = Field(description="of every random number but those of an attack, whose seed is in its row")
    versions: dict[str, str]
    backend: str
    load: str = Field(description="load of the machine when the measurement ended")


class Report(BaseModel):
    """The contents of `work-precision.json`: the rows of each measured part, and its measurement."""

    model_config = ConfigDict(extra="forbid")

    measured: dict[str, Measurement] = Field(default_factory=dict, description="by name of a part")
    shading: list[ShadingRow] = Field(default_factory=list)
    maps: list[MapRow] = Field(default_factory=list)
    shadows: list[ShadowRow] = Field(default_factory=list)
    scenes: list[SceneRow] = Field(default_factory=list)
    signs: list[SignRow] = Field(default_factory=list)
    attacks: list[AttackRow] = Field(default_factory=list)


def _shading(extent: Extent) -> Iterator[ShadingRow]:
    for mesh, material, size, maps in extent.subjects:
        for texels in maps:
            yield from shading.rows(shading.subject(mesh, material, size, texels), extent.enough)


def _maps(extent: Extent) -> Iterator[MapRow]:
    mesh, _, size, _ = extent.subjects[0]
    return scene_options.map_rows(mesh, size)


PARTS: dict[str, Callable[[Extent], Iterable[BaseModel]]] = {
    "shading": _shading,
    "maps": _maps,
    "shadows": lambda extent: scene_options.shadow_rows(extent.scene, extent.enough),
    "scenes": lambda extent: scene_options.option_rows(extent.scene, extent.enough),
    "signs": lambda extent: attack_runs.sign_rows(*extent.signs),
    "attacks": lambda extent: map(attack_runs.attack, attack_runs.cases(extent.scenes, extent.steps, extent.zoo)),
}
"""The parts in the order in which they are measured. Each is a field of the report."""


def measure(
    extent: Extent,
    folder: Path,
    command: str,
    only: Sequence[str] = (),
    on_part: Callable[[str], None] = lambda _: None,
) -> Report:
    """Measures the parts named in `only`, or all of PARTS, into the report that the folder has, if it has one.

    The report is written after each part, so that `only` measures the rest where it was stopped. `command` is what was
    asked; `on_part` is called with the name of each part that starts. Raises ValidationError for a file that is no
    report.
    """
    report = read(folder) or Report()
    for name in only or PARTS:
        on_part(name)
        rows = list(PARTS[name](extent))
        now = Measurement(
            when=datetime.now(UTC).isoformat(timespec="seconds"),
            command=command,
            seed=0,
            versions=versions(*PACKAGES),
            backend=backend(),
            load=f"{os.getloadavg()[2]:.1f} processes in the last 15 minutes, {os.cpu_count()} processors",
        )
        report = report.model_copy(update={name: rows, "measured": report.measured | {name: now}})
        write(report, folder)
    return report


def read(folder: Path) -> Report | None:
    """The report that the folder has; None if it has none. Raises ValidationError for a file that is no report."""
    path = folder / f"{NAME}.json"
    return Report.model_validate_json(path.read_text("utf-8")) if path.exists() else None


def write(made: Report, folder: Path) -> None:
    """Writes `work-precision.json`, `.csv` and `.md` into the folder, which is created if necessary."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.json").write_text(data(made), "utf-8")
    (folder / f"{NAME}.csv").write_text(all_rows(made), "utf-8")
    (folder / f"{NAME}.md").write_text(markdown(made), "utf-8")


def data(made: Report) -> str:
    """The report as JSON, one row to a line."""
    parts = []
    for name, part in made.model_dump(mode="json").items():
        rows = part if isinstance(part, list) else [part]
        lines = ",\n  ".join(json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows)
        parts.append(f' "{name}": ' + (f"[\n  {lines}\n ]" if isinstance(part, list) else lines))
    return "{\n" + ",\n".join(parts) + "\n}\n"


def all_rows(made: Report) -> str:
    """Every row of every part as CSV. `part` is its first column; a value within a value is named "forward.median"."""
    rows = [
        {"part": part} | dict(_flat(row.model_dump(mode="json")))
        for part in PARTS
        for row in (*getattr(made, part), *(success_rows(made.attacks) if part == "attacks" else ()))
    ]
    text = StringIO()
    columns = dict.fromkeys(column for row in rows for column in row)
    writer = csv.DictWriter(text, list(columns) or ["part"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _flat(row: dict[str, object], before: str = "") -> Iterator[tuple[str, object]]:
    for name, value in row.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", " ".join(map(str, value)) if isinstance(value, list) else value


# The page

SUMS = """The sum over all directions and lobes of {row.object} under a map of {row.map[0]}×{row.map[1]}, with
gradients by all three groups. The compiled kernels use float32 within a tolerance and float64 exactly. Without a
compiler, torch computes the same more slowly. bfloat16 is not accurate enough, and float16 cannot hold the
exponentials of lobes."""

TOLERANCE = f"""The default, {DEFAULT:g}, is a quarter of a step of 8 bits. The verdict is on the exact image at every
tolerance: an error may cost an attack steps, but nothing is verified because of it. `exact` is for studies of
gradients and comparisons with other programs."""

PLANS = """*Largest* and *estimate* are errors of a displayed value, against the float64 sum; *gradient* is the largest
relative error (L2) of the attacked groups' gradients. Seconds are of an image and its gradient. The scene is some
way into an attack. Where a table was tried and its check failed, the note says so: that image cost more."""

MAPS = """A scene's light is its map averaged down to a grid of `size`; every other error on this page is for the grid
as it is given. Differences of displayed values between exact images, from the image under one of
{row.reference[0]}×{row.reference[1]}:"""

SHADOWS = """Exact images beside those with the finest shadows; differences of displayed values over covered pixels.
Seconds are of an image (pyrender), or of the visibility, which is found once (torch)."""

SCENES = f"""{scene_options.SCENE}: first without options, then with one more of them at a time, some way into an
attack on the renderer's default groups. Differences are from the exact image, over covered pixels. *Share* is of those
that are off by more than 1/255. *Estimate* is the plan's: of the largest error (torch), or of the mean (pyrender)."""

SIGNS = """Signs of the gradient of the network's log-odds, against float64 throughout. *By weight* is the part w of the
gradient's absolute sum that the wrong ones hold: a step by signs keeps 1 − 2w of its gain. An attack takes the
network's gradient at the 8-bit image, which costs more signs than a plan does."""

ATTACKS = """Attacks on EfficientNet-Lite0 under a studio map of 16×32. *Verified*: the exact image, saved in 8 bits,
fools the network. Medians have 95 % bootstrap intervals over the scenes, rates Wilson's; an attack that held counts as
more work than its budget."""

OMISSIONS = """
- Shading is measured for one object of one material at a time, on a processor, not on a GPU.
- Seconds of shading leave out the network, the rasterised geometry and making the plan, which a job does once.
- The viewer is far away, as is the default. One at the camera (`viewer: perspective`) is summed pixel by pixel.
- The function whose gradient shading is judged by is a weighted sum of the image with smooth random weights.
- Attacks are measured without a floor and shadows.
- Mitsuba has no material of this model; [Benchmarks](../reports/benchmarks.md) compares its speed on a problem of that
  size."""


def markdown(made: Report) -> str:
    """The page of the measured parts: the choice of a tolerance, then error against seconds, option by option."""
    plans = [row for row in made.shading if row.tolerance is not None]
    sums = [row for row in made.shading if row.tolerance is None and row.map == DEFAULT_MAP]
    attacks = list(success_rows(made.attacks))
    # All groups on every subject, and single groups on the first one under the default map.
    shown = [row for row in plans if row.groups == GROUPS or (row.mesh, row.map) == (plans[0].mesh, DEFAULT_MAP)]
    sections = [
        "# Error against run time",
        f"Every row is in [{NAME}.csv]({NAME}.csv). [How it works](../how-it-works.md) says what a plan leaves out.",
        "## Which tolerance",
        TOLERANCE,
        *_tolerances(made, plans, attacks),
        *_section("Plans", PLANS, PLAN_COLUMNS, shown),
        *_section("Types of number", SUMS, SUM_COLUMNS, [row for row in sums if row.mesh == sums[0].mesh]),
        *_section("Resolution of the environment map", MAPS, MAP_COLUMNS, made.maps),
        *_section("Resolution of shadows", SHADOWS, SHADOW_COLUMNS, made.shadows),
        *_section("Surfaces, floor and shadows", SCENES, SCENE_COLUMNS, made.scenes),
        *_section(
            "Signs that FGSM takes",
            SIGNS,
            SIGN_COLUMNS,
            [row for row in made.signs if row.tolerance in (DEFAULT, "exact")],
        ),
        *_section("Work to a verified adversary", ATTACKS, ATTACK_COLUMNS, attacks),
        "## What is left out",
        OMISSIONS.strip(),
        "## How to make this page again",
        "\n".join(_provenance(made)),
    ]
    return "\n\n".join(sections) + "\n"


def _section(heading: str, words: str, columns: Mapping[str, Callable[[Row], str]], rows: Sequence[Row]) -> list[str]:
    """A table under its heading and text, which may name {fields} of the first row; empty without rows."""
    return [f"## {heading}", words.format(row=rows[0]), table(columns, rows)] if rows else []


def _tolerances(made: Report, plans: Sequence[ShadingRow], attacks: Sequence[SuccessRow]) -> Iterator[str]:
    """Advice on the choice of a tolerance, from the rows."""
    points = []
    by = {_named(row.tolerance): row for row in attacks if row.groups == GROUPS}
    if by:
        verified = ", ".join(f"{row.verified} of {row.attacks} ({tolerance})" for tolerance, row in by.items())
        steps = ", ".join(f"{row.seconds_per_step:.2g} s ({tolerance})" for tolerance, row in by.items())
        points.append(f"Attacks on all three torch groups were verified in {verified}; a step took {steps}.")
    judged = [row for row in plans if row.estimate is not None and row.largest is not None]
    if judged:
        held = sum((row.largest or 0) <= max(row.estimate or 0, EXACTLY) for row in judged)
        points.append(f"The largest error of an image was within the plan's estimate in {held} of {len(judged)} plans.")
    default_map = [row.largest for row in made.maps if row.map == DEFAULT_MAP]
    if default_map:
        points.append(
            f"A map of {_grid(DEFAULT_MAP)} texels is off by up to {max(default_map):.2g}: choose a larger map before "
            "a smaller tolerance."
        )
    if points:
        yield "\n".join(f"- {point}" for point in points)


def _provenance(made: Report) -> Iterator[str]:
    yield "Seconds are medians of several runs after one that warms up; they mean something only on a machine that does"
    yield "nothing else. Each part says how it was measured:"
    yield ""
    for how in dict.fromkeys(measurement.model_dump_json() for measurement in made.measured.values()):
        names = ", ".join(name for name, measurement in made.measured.items() if measurement.model_dump_json() == how)
        measurement = Measurement.model_validate_json(how)
        numbers = ", ".join(f"{name} {number}" for name, number in measurement.versions.items())
        origin = f"`{measurement.command}`, {measurement.when}, seed {measurement.seed}"
        yield f"- {names}: {origin}; load: {measurement.load}; {measurement.backend}; {numbers}."


def _groups(row: ShadingRow | SuccessRow) -> str:
    return "all three" if row.groups == GROUPS else ", ".join(row.groups)


def _grid(texels: tuple[int, int]) -> str:
    return f"{texels[0]}×{texels[1]}"


def _named(tolerance: float | str | None) -> str:
    return f"{tolerance:g}" if isinstance(tolerance, float) else str(tolerance)


def _gradient(row: ShadingRow) -> str:
    return small(max(row.gradient.values(), default=None))


def _seconds(row: ShadingRow) -> str:
    return "" if row.both is None else f"{row.both.median:.2g}"


def _interval(of: Interval) -> str:
    median, low, high = ("> budget" if value is None else f"{value:.3g}" for value in (of.median, of.low, of.high))
    return "> budget" if of.low is None else f"{median} [{low}, {high}]"


PLAN_COLUMNS: dict[str, Callable[[ShadingRow], str]] = {
    "object": lambda row: row.object,
    "map": lambda row: _grid(row.map),
    "attacked": _groups,
    "tolerance>": lambda row: _named(row.tolerance),
    "largest>": lambda row: small(row.largest),
    "estimate>": lambda row: small(row.estimate),
    "gradient>": _gradient,
    "seconds>": _seconds,
    "note": lambda row: row.note,
}
SUM_COLUMNS: dict[str, Callable[[ShadingRow], str]] = {
    "type": lambda row: row.dtype,
    "kernel": lambda row: row.kernel,
    "largest>": lambda row: small(row.largest),
    "gradient>": _gradient,
    "seconds>": _seconds,
}
MAP_COLUMNS: dict[str, Callable[[MapRow], str]] = {
    "material": lambda row: row.material,
    "map": lambda row: _grid(row.map),
    "largest>": lambda row: small(row.largest),
    "rms>": lambda row: small(row.rms),
}
SHADOW_COLUMNS: dict[str, Callable[[ShadowRow], str]] = {
    "renderer": lambda row: row.renderer,
    "shadows": lambda row: row.fineness,
    "beside": lambda row: row.reference,
    "mean>": lambda row: small(row.mean),
    "largest>": lambda row: small(row.largest),
    "seconds>": lambda row: f"{row.seconds:.2g}",
}
SCENE_COLUMNS: dict[str, Callable[[SceneRow], str]] = {
    "scene": lambda row: row.scene,
    "renderer": lambda row: row.renderer,
    "tolerance>": lambda row: _named(row.tolerance),
    "mean>": lambda row: small(row.mean),
    "share>": lambda row: f"{row.share:.2%}",
    "largest>": lambda row: small(row.largest),
    "estimate>": lambda row: small(row.estimate),
    "seconds>": lambda row: f"{row.seconds:.2g}",
}
SIGN_COLUMNS: dict[str, Callable[[SignRow], str]] = {
    "attacked": lambda row: row.group,
    "tolerance>": lambda row: _named(row.tolerance),
    "network sees": lambda row: row.image,
    "wrong signs>": lambda row: f"{row.wrong_signs:.1%}",
    "by weight>": lambda row: f"{row.wrong_weight:.2%}",
}
ATTACK_COLUMNS: dict[str, Callable[[SuccessRow], str]] = {
    "method": lambda row: row.method,
    "renderer": lambda row: row.renderer,
    "attacked": _groups,
    "tolerance>": lambda row: _named(row.tolerance),
    "verified>": lambda row: f"{row.verified} of {row.attacks}",
    "rate>": lambda row: f"{row.rate_low:.0%}–{row.rate_high:.0%}",
    "queries": lambda row: _interval(row.queries),
    "seconds": lambda row: _interval(row.seconds),
    "a step>": lambda row: f"{row.seconds_per_step:.2g}",
    "budget>": lambda row: f"{row.max_steps} steps",
}
