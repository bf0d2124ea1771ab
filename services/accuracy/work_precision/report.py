"""Error against run time: extent of the measurements, their runner, and the report as a page and as JSON."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.provenance import Provenance
from services.accuracy.tables import Row, rows_as_json, small, table
from services.accuracy.work_precision import attacks as attack_runs
from services.accuracy.work_precision import scene_options, shading
from services.accuracy.work_precision.attacks import AttackRow, Success, successes
from services.accuracy.work_precision.scene_options import OptionRow
from services.accuracy.work_precision.shading import GROUPS, ShadingRow
from services.rendering.plan import Tolerance

NAME = "work-precision"
DEFAULT = 1e-3
"""The tolerance of a job that names none."""
DEFAULT_MAP = (16, 32)
DEFAULT_MAP_SETTING = "16×32 texels"
EXACTLY = 1e-12
"""Largest error of a plan that estimates none: its sum is the reference's."""


# What is measured


@dataclass(frozen=True)
class Extent:
    """The extent of the measurements.

    subjects: mesh, material, size of the image and sizes of maps that are shaded; enough: seconds for each time that
    is taken; scene: size of the image of a CLEVR-style scene. scenes and steps of attacks; zoo: its settings.
    """

    subjects: tuple[tuple[str, str, tuple[int, int], tuple[tuple[int, int], ...]], ...]
    enough: float
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
    scene=(240, 320),
    scenes=len(attack_runs.SCENES),
    steps=60,
    zoo={"steps": 40},
)
QUICK = Extent(
    subjects=(("furniture/soccer-ball", "brushed-metal", (64, 64), ((4, 8), (16, 32))),),
    enough=0.02,
    scene=(48, 64),
    scenes=1,
    steps=5,
    zoo={"steps": 2, "delta": 1e-2},
)


class Report(BaseModel):
    """The contents of `work-precision.json`: the rows of each measured part, and how they were measured."""

    model_config = ConfigDict(extra="forbid")

    measured: dict[str, Provenance] = Field(default_factory=dict, description="by name of a part")
    shading: list[ShadingRow] = Field(default_factory=list)
    maps: list[OptionRow] = Field(default_factory=list)
    shadows: list[OptionRow] = Field(default_factory=list)
    scenes: list[OptionRow] = Field(default_factory=list)
    attacks: list[AttackRow] = Field(default_factory=list)


def _shading(extent: Extent) -> Iterator[ShadingRow]:
    for mesh, material, size, maps in extent.subjects:
        for texels in maps:
            yield from shading.rows(mesh, material, size, texels, extent.enough)


PARTS: dict[str, Callable[[Extent], Iterable[BaseModel]]] = {
    "shading": _shading,
    "maps": lambda extent: scene_options.map_rows(extent.subjects[0][0], extent.subjects[0][2], extent.enough),
    "shadows": lambda extent: scene_options.shadow_rows(extent.scene, extent.enough),
    "scenes": lambda extent: scene_options.option_rows(extent.scene, extent.enough),
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
        report = report.model_copy(update={name: rows, "measured": report.measured | {name: Provenance.now(command)}})
        write(report, folder)
    return report


def read(folder: Path) -> Report | None:
    """The report that the folder has; None if it has none. Raises ValidationError for a file that is no report."""
    path = folder / f"{NAME}.json"
    return Report.model_validate_json(path.read_text("utf-8")) if path.exists() else None


def write(made: Report, folder: Path) -> None:
    """Writes `work-precision.json` and `.md` into the folder, which is created if necessary."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.json").write_text(rows_as_json(made.model_dump(mode="json")), "utf-8")
    (folder / f"{NAME}.md").write_text(markdown(made), "utf-8")


# The page

TOLERANCE = f"""The default, {DEFAULT:g}, is a quarter of a step of 8 bits. The verdict is on the exact image at every
tolerance: an error may cost an attack steps, but nothing is verified because of it. `exact` is for studies of
gradients and comparisons with other programs."""

PLANS = """*Largest* and *estimate* are errors of a displayed value, against the exact image; *gradient* is the largest
relative error (L2) of the attacked groups' gradients. Seconds are of an image and its gradient. The scene is some
way into an attack. Where a table was tried and its check failed, the note says so: that image cost more."""

MAPS = f"""A scene's light is its map averaged down to a grid of `size`; every other error on this page is for the grid
as it is given. Differences of displayed values between exact images, from the image under one of
{scene_options.MAP_SIZES[0][0]}×{scene_options.MAP_SIZES[0][1]}:"""

SHADOWS = """Exact images beside those with the finest shadows; differences of displayed values over covered pixels.
Settings are fields of `scene.shadows`. Seconds are of an image and of what its renderer prepares for it, which a job
does once: visibility (torch)."""

SCENES = f"""{scene_options.SCENE}: first without options, then with one more of them at a time, some way into an
attack on the renderer's default groups. Differences are from the exact image, over covered pixels. *Share* is of those
that are off by more than 1/255. *Estimate* is the plan's: of the largest error (torch), or of the mean (pyrender)."""

ATTACKS = """Attacks on EfficientNet-Lite0 under a studio map of 16×32. *Verified*: the exact image, saved in 8 bits,
fools the network. *Queries* and *seconds* are medians over the scenes, where an attack that held counts as more work
than its budget; rates have Wilson's 95 % interval."""

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
    plans = made.shading
    attacks = successes(made.attacks)
    # All groups on every subject, and single groups on the first one under the default map.
    shown = [row for row in plans if row.groups == GROUPS or (row.mesh, row.map) == (plans[0].mesh, DEFAULT_MAP)]
    sections = [
        "# Error against run time",
        f"Every row is in [{NAME}.json]({NAME}.json). [How it works](../how-it-works.md) says what a plan leaves out.",
        "## Which tolerance",
        TOLERANCE,
        *_tolerances(made, plans, attacks),
        *_section("Plans", PLANS, PLAN_COLUMNS, shown),
        *_section("Resolution of the environment map", MAPS, OPTION_COLUMNS, made.maps),
        *_section("Resolution of shadows", SHADOWS, OPTION_COLUMNS, made.shadows),
        *_section("Surfaces, floor and shadows", SCENES, OPTION_COLUMNS, made.scenes),
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


def _tolerances(made: Report, plans: Sequence[ShadingRow], attacks: Sequence[Success]) -> Iterator[str]:
    """Advice on the choice of a tolerance, from the rows."""
    points = []
    by = {_named(row.kind.tolerance): row for row in attacks if row.kind.groups == GROUPS}
    if by:
        verified = ", ".join(f"{row.verified} of {len(row.attacks)} ({tolerance})" for tolerance, row in by.items())
        steps = ", ".join(f"{row.seconds_per_step:.2g} s ({tolerance})" for tolerance, row in by.items())
        points.append(f"Attacks on all three torch groups were verified in {verified}; a step took {steps}.")
    if plans:
        held = sum(row.largest <= max(row.estimate, EXACTLY) for row in plans)
        points.append(f"The largest error of an image was within the plan's estimate in {held} of {len(plans)} plans.")
    default_map = [row.largest for row in made.maps if row.setting == DEFAULT_MAP_SETTING]
    if default_map:
        points.append(
            f"A map of {DEFAULT_MAP_SETTING} is off by up to {max(default_map):.2g}: choose a larger map before "
            "a smaller tolerance."
        )
    if points:
        yield "\n".join(f"- {point}" for point in points)


def _provenance(made: Report) -> Iterator[str]:
    yield "Seconds are medians of several runs after one that warms up; they mean something only on a machine that does"
    yield "nothing else. Each part says how it was measured:"
    yield ""
    for words in dict.fromkeys(provenance.words() for provenance in made.measured.values()):
        yield f"- {', '.join(name for name, of in made.measured.items() if of.words() == words)}: {words}."


def _groups(row: ShadingRow | AttackRow) -> str:
    return "all three" if row.groups == GROUPS else ", ".join(row.groups)


def _grid(texels: tuple[int, int]) -> str:
    return f"{texels[0]}×{texels[1]}"


def _named(tolerance: Tolerance) -> str:
    return f"{tolerance:g}" if isinstance(tolerance, float) else str(tolerance)


def _seconds(seconds: float) -> str:
    return f"{seconds:.2g}"


def _work(median: float) -> str:
    return f"{median:.3g}" if isfinite(median) else "> budget"


PLAN_COLUMNS: dict[str, Callable[[ShadingRow], str]] = {
    "object": lambda row: row.object,
    "map": lambda row: _grid(row.map),
    "attacked": _groups,
    "tolerance>": lambda row: _named(row.tolerance),
    "largest>": lambda row: small(row.largest),
    "estimate>": lambda row: small(row.estimate),
    "gradient>": lambda row: small(max(row.gradient.values())),
    "seconds>": lambda row: _seconds(row.seconds),
    "note": lambda row: "checked, and summed pixel by pixel after all" if row.summed else "",
}
OPTION_COLUMNS: dict[str, Callable[[OptionRow], str]] = {
    "scene": lambda row: row.scene,
    "renderer": lambda row: row.renderer,
    "setting": lambda row: row.setting,
    "mean>": lambda row: small(row.mean),
    "share>": lambda row: f"{row.share:.2%}",
    "largest>": lambda row: small(row.largest),
    "estimate>": lambda row: small(row.estimate),
    "seconds>": lambda row: _seconds(row.seconds),
}
ATTACK_COLUMNS: dict[str, Callable[[Success], str]] = {
    "method": lambda row: row.kind.method,
    "renderer": lambda row: row.kind.renderer,
    "attacked": lambda row: _groups(row.kind),
    "tolerance>": lambda row: _named(row.kind.tolerance),
    "verified>": lambda row: f"{row.verified} of {len(row.attacks)}",
    "rate>": lambda row: f"{row.rate[0]:.0%}–{row.rate[1]:.0%}",
    "queries>": lambda row: _work(row.median("queries")),
    "seconds>": lambda row: _work(row.median("seconds")),
    "a step>": lambda row: _seconds(row.seconds_per_step),
    "budget>": lambda row: f"{row.kind.max_steps} steps",
}
