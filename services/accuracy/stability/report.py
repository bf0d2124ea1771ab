"""All stiff and extreme cases, one after another, and their results, as a page and as data."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from services.accuracy.provenance import PACKAGES, backend
from services.accuracy.stability import (
    attacks,
    geometry,
    materials,
    meshes,
    networks,
    pyrender_light,
    torch_light,
    torch_shading,
)
from services.accuracy.stability.case import Case, Observation, observe
from services.accuracy.tables import small, table
from services.process import versions

FAMILIES: dict[str, Callable[[], list[Case]]] = {
    "lobes": torch_shading.lobe_cases,
    "normals": torch_shading.normal_cases,
    "environments": torch_light.environment_cases,
    "plans": torch_light.plan_cases,
    "views": geometry.view_cases,
    "poses": geometry.pose_cases,
    "meshes": meshes.mesh_cases,
    "textures": meshes.texture_cases,
    "materials": materials.material_cases,
    "lights": pyrender_light.light_cases,
    "shadows": pyrender_light.shadow_cases,
    "logits": networks.logit_cases,
    "differences": attacks.difference_cases,
    "recurrences": attacks.recurrence_cases,
    "steps": attacks.step_cases,
    "sizes": geometry.size_cases,
    "precision": networks.precision_cases,
}


def cases(quick: bool = False) -> list[Case]:
    """Every case, in the order of the report; with `quick` those that take a second or two at most."""
    all_cases = [replace(case, family=name) for name, family in FAMILIES.items() for case in family()]
    return [case for case in all_cases if not (quick and case.slow)]


def run(chosen: Sequence[Case], on_case: Callable[[Case], None] = lambda _: None) -> list[Observation]:
    """Runs the cases; `on_case` is called before each."""
    observations = []
    for case in chosen:
        on_case(case)
        observations.append(observe(case))
    return observations


WORDS = {
    "ok": "the property held",
    "flat": "nothing could be learnt, and the method said so",
    "clipped": "values were held at a bound or at display white, as they must be",
    "refused": "a clear error, naming the field or the kind of failure",
    "failed": "the property did not hold",
}


class Report(BaseModel):
    """The contents of `stability.json`."""

    model_config = ConfigDict(extra="forbid")

    command: str
    seed: str
    versions: dict[str, str]
    backend: str
    counts: dict[str, int]
    cases: list[Observation]

    @property
    def failed(self) -> list[Observation]:
        """The cases that failed."""
        return [row for row in self.cases if row.outcome == "failed"]


def report(observations: Sequence[Observation], command: str) -> Report:
    """Returns the observations with the data needed to reproduce them."""
    return Report(
        command=command,
        seed="each case has its own, in its code",
        versions=versions(*PACKAGES),
        backend=backend(),
        counts={word: sum(row.outcome == word for row in observations) for word in WORDS},
        cases=list(observations),
    )


def markdown(found: Report) -> str:
    """The page."""
    counted = ", ".join(f"{count} {word}" for word, count in found.counts.items() if count or word == "failed")
    lines = [
        "# Stability",
        "",
        f"Stiff and extreme cases, each with a property that must hold: {len(found.cases)} cases, {counted}.",
        "",
        *(f"- *{word}*: {meaning}" for word, meaning in WORDS.items()),
        "",
        "*Measured* must be at most its *tolerance*; what it is, and what it was compared with, stands beside it.",
        "Every case has been seen to fail with the product broken on purpose (`tests/unit/accuracy/sabotage.py` and",
        "`mutants.py` list how).",
    ]
    for family in dict.fromkeys(row.family for row in found.cases):
        rows = [row for row in found.cases if row.family == family]
        lines += ["", f"## {family.capitalize()}", "", table(COLUMNS, rows)]
    lines += ["", "## How to make this page again", "", "```sh", found.command, "```", ""]
    lines += [f"{found.backend}; " + ", ".join(f"{name} {number}" for name, number in found.versions.items()) + "."]
    lines += [f"Seeds: {found.seed}. Seconds are told so roughly that two runs on one machine give"]
    lines += ["the same page."]
    return "\n".join(lines) + "\n"


COLUMNS: dict[str, Callable[[Observation], str]] = {
    "case": lambda row: row.name,
    "what is stiff": lambda row: row.stiff,
    "must hold": lambda row: row.must,
    "outcome": lambda row: f"**{row.outcome}**" if row.outcome == "failed" else row.outcome,
    "measured>": lambda row: small(row.measured),
    "tolerance>": lambda row: small(row.tolerance),
    "how it was seen": lambda row: row.what,
    "seconds": lambda row: row.seconds,
}


def write(found: Report, folder: Path) -> None:
    """Writes `stability.md` and `stability.json` into the folder, which is created if necessary."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stability.json").write_text(found.model_dump_json(indent=1) + "\n", "utf-8")
    (folder / "stability.md").write_text(markdown(found), "utf-8")
