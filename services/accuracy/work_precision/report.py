"""What error costs in time, as a page and as data."""

import json
import os
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.work_precision import tables
from services.accuracy.work_precision.attack_runs import AttackRow
from services.accuracy.work_precision.collect import Found
from services.accuracy.work_precision.convergence import OrderRow
from services.accuracy.work_precision.gradients import GradientRow, Reference
from services.accuracy.work_precision.independent_check import IndependentRow
from services.accuracy.work_precision.map_resolution import MapRow
from services.accuracy.work_precision.network_signs import SignRow
from services.accuracy.work_precision.shading_rows import CannotRunRow, ShadingRow
from services.accuracy.work_precision.shadow_resolution import ShadowRow
from services.accuracy.work_precision.success import SuccessRow
from services.accuracy.work_precision.words import OMISSIONS, conclusions
from services.versions import versions

NAME = "work-precision"


class Report(BaseModel):
    """Everything that `work-precision.json` says."""

    model_config = ConfigDict(extra="forbid")

    command: str
    seed: int = Field(description="of every random number but those of an attack, whose seed is in its row")
    versions: dict[str, str]
    backend: str
    load: str = Field(description="load of the machine when the report was written")
    success: list[SuccessRow]
    independent: list[IndependentRow]
    maps: list[MapRow]
    shadows: list[ShadowRow]
    orders: list[OrderRow]
    signs: list[SignRow]
    shading: list[ShadingRow]
    cannot_run: list[CannotRunRow]
    references: list[Reference]
    gradients: list[GradientRow]
    attacks: list[AttackRow]


def report(found: Found, command: str, load: str) -> Report:
    """What was measured, with what is needed to measure it again; `load` says what else the machine did meanwhile."""
    return Report(
        command=command,
        seed=0,
        versions=versions(*PACKAGES, "matplotlib"),
        backend=backend(),
        load=load,
        **vars(found),
    )


def load() -> str:
    """The machine's mean number of waiting and running processes beside its processors, where the system tells it."""
    if not hasattr(os, "getloadavg"):
        return "unknown"
    return f"{os.getloadavg()[2]:.1f} processes in the last 15 minutes, {os.cpu_count()} processors"


def write(made: Report, folder: Path) -> None:
    """`work-precision.md`, `.json` and `.png` in the folder, which is made if need be."""
    from services.accuracy.work_precision.curves import draw  # matplotlib takes a second to import

    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.json").write_text(_json(made), "utf-8")
    (folder / f"{NAME}.md").write_text(markdown(made), "utf-8")
    draw(made.shading, made.gradients, made.attacks, folder / f"{NAME}.png")


def _json(made: Report) -> str:
    """One row to a line."""

    def text(value: object) -> str:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)

    def entry(value: object) -> str:
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
    lines += [*tables.maps(made.maps), "", *tables.shadows(made.shadows), ""]
    lines += [*tables.orders(made.orders), "", *tables.signs(made.signs), ""]
    lines += [*tables.shading(made.shading, made.cannot_run), "", *tables.gradients(made.gradients, made.references)]
    lines += ["", *tables.attacks(made.attacks), "", "## What is left out", "", *(f"- {words}" for words in OMISSIONS)]
    return "\n".join([*lines, "", *_provenance(made)]) + "\n"


def _provenance(made: Report) -> Iterator[str]:
    yield from ("## How to make this page again", "", "```sh", made.command, "```", "")
    yield "The command goes on where it was stopped, and deletes what it kept for that when the page is written."
    yield f"{made.backend}; " + ", ".join(f"{name} {number}" for name, number in made.versions.items()) + "."
    yield (
        f"Seed {made.seed}. Seconds are medians [first to third quartile] of several runs after one that warms up, on "
        f"this machine. Load of the machine while it ran: {made.load}."
    )
