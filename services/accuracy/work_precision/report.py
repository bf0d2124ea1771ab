"""What error costs in time, as a page and as data."""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.work_precision import scene_tables, tables
from services.accuracy.work_precision.attack_runs import AttackRow
from services.accuracy.work_precision.collect import PARTS, Found
from services.accuracy.work_precision.convergence import OrderRow
from services.accuracy.work_precision.gradients import GradientRow, Reference
from services.accuracy.work_precision.independent_check import IndependentRow
from services.accuracy.work_precision.map_resolution import MapRow
from services.accuracy.work_precision.network_signs import SignRow
from services.accuracy.work_precision.scene_options import SceneRow
from services.accuracy.work_precision.shading_rows import CannotRunRow, ShadingRow
from services.accuracy.work_precision.shadow_resolution import ShadowRow
from services.accuracy.work_precision.success import SuccessRow
from services.accuracy.work_precision.words import OMISSIONS, conclusions
from services.versions import versions

NAME = "work-precision"


class Measurement(BaseModel):
    """When, how and on what the rows of a part were measured."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    when: str = Field(description="UTC, when the measurement ended")
    command: str
    seed: int = Field(description="of every random number but those of an attack, whose seed is in its row")
    versions: dict[str, str]
    backend: str
    load: str = Field(description="load of the machine when the measurement ended")


class Report(BaseModel):
    """Everything that `work-precision.json` says."""

    model_config = ConfigDict(extra="forbid")

    measured: dict[str, Measurement] = Field(description="by name of a part, of those that were measured")
    success: list[SuccessRow]
    independent: list[IndependentRow]
    maps: list[MapRow]
    shadows: list[ShadowRow]
    scenes: list[SceneRow]
    orders: list[OrderRow]
    signs: list[SignRow]
    shading: list[ShadingRow]
    cannot_run: list[CannotRunRow]
    references: list[Reference]
    gradients: list[GradientRow]
    attacks: list[AttackRow]


def report(found: Found, command: str, load: str, only: Sequence[str] = (), before: Report | None = None) -> Report:
    """What was measured, with what is needed to measure it again; `load` says what else the machine did meanwhile.

    `found` has the parts named in `only`, or all of them; the others are those of the report `before`, if there is one.
    """
    now = Measurement(
        when=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command,
        seed=0,
        versions=versions(*PACKAGES, "matplotlib"),
        backend=backend(),
        load=load,
    )
    measured = dict.fromkeys(only or PARTS, now)
    if before is None:
        return Report(measured=measured, **vars(found))
    rows = {name: getattr(found, name) for part in measured for name in PARTS[part].fields}
    return before.model_copy(update={"measured": before.measured | measured, **rows})


def load() -> str:
    """The machine's mean number of waiting and running processes beside its processors, where the system tells it."""
    if not hasattr(os, "getloadavg"):
        return "unknown"
    return f"{os.getloadavg()[2]:.1f} processes in the last 15 minutes, {os.cpu_count()} processors"


def read(folder: Path) -> Report | None:
    """The report that the folder has; None if it has none. Raises ValidationError for a file that is no report."""
    path = folder / f"{NAME}.json"
    return Report.model_validate_json(path.read_text("utf-8")) if path.exists() else None


def write(made: Report, folder: Path) -> None:
    """`work-precision.md`, `.json` and `.png` in the folder, which is made if need be."""
    from services.accuracy.work_precision.curves import draw  # matplotlib takes a second to import

    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.json").write_text(_json(made), "utf-8")
    (folder / f"{NAME}.md").write_text(markdown(made), "utf-8")
    if made.shading and made.gradients and made.attacks:
        draw(made.shading, made.gradients, made.attacks, folder / f"{NAME}.png")


def _json(made: Report) -> str:
    """One row to a line."""

    def text(value: object) -> str:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)

    def entry(value: object) -> str:
        if isinstance(value, dict):
            return "{\n  " + ",\n  ".join(f"{text(name)}: {text(own)}" for name, own in value.items()) + "\n }"
        return "[\n  " + ",\n  ".join(map(text, value)) + "\n ]" if isinstance(value, list) else text(value)

    data = made.model_dump(mode="json")
    return "{\n" + ",\n".join(f" {text(name)}: {entry(value)}" for name, value in data.items()) + "\n}\n"


def markdown(made: Report) -> str:
    """The page: conclusions, then the figure, then every number."""
    lines = ["# Error against run time", "", "## Conclusions", ""]
    found = Found(**{part.name: getattr(made, part.name) for part in fields(Found)})
    lines += [f"- {words}" for words in conclusions(found)]
    lines += ["", f"![Error against seconds, evaluations and steps]({NAME}.png)", ""]
    lines += [*tables.success(made.success), "", *tables.independent(made.independent), ""]
    lines += [*scene_tables.maps(made.maps), "", *scene_tables.shadows(made.shadows), ""]
    lines += [*scene_tables.scenes(made.scenes), ""]
    lines += [*tables.orders(made.orders), "", *tables.signs(made.signs), ""]
    lines += [*tables.shading(made.shading, made.cannot_run), "", *tables.gradients(made.gradients, made.references)]
    lines += ["", *tables.attacks(made.attacks), "", "## What is left out", "", *(f"- {words}" for words in OMISSIONS)]
    return "\n".join([*lines, "", *_provenance(made)]) + "\n"


def _provenance(made: Report) -> Iterator[str]:
    yield from ("## How to make this page again", "")
    yield "Each part was measured by a command of its own or by that of the whole page, which goes on where it was"
    yield "stopped and deletes what it kept for that when the page is written. Seconds are medians [first to third"
    yield "quartile] of several runs after one that warms up, on this machine."
    yield ""
    parts: dict[str, list[str]] = {}
    for name, one in made.measured.items():
        parts.setdefault(one.model_dump_json(), []).append(name)
    for text, names in parts.items():
        one = Measurement.model_validate_json(text)
        numbers = ", ".join(f"{name} {number}" for name, number in one.versions.items())
        yield (
            f"- {', '.join(names)}: `{one.command}`, {one.when}, seed {one.seed}; load of the machine: {one.load}; "
            f"{one.backend}; {numbers}."
        )
