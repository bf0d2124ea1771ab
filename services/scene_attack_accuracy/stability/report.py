"""All stiff and extreme cases, one after another, and their results, as a page and as data."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from scene_attack_accuracy.provenance import Provenance
from scene_attack_accuracy.stability import (
    attacks,
    geometry,
    materials,
    meshes,
    networks,
    pyrender_light,
    torch_light,
    torch_shading,
)
from scene_attack_accuracy.stability.case import Case, Observation
from scene_attack_accuracy.tables import rows_as_json, small, table

FAMILIES: dict[str, Callable[[], Iterator[Case]]] = {
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

    measured: Provenance
    cases: list[Observation]

    def count(self, outcome: str, family: str | None = None) -> int:
        """The number of cases with an outcome, of a family or of all."""
        return sum(row.outcome == outcome and family in (None, row.family) for row in self.cases)

    @property
    def families(self) -> dict[str, list[Observation]]:
        """The cases by family."""
        names = dict.fromkeys(row.family for row in self.cases)
        return {name: [row for row in self.cases if row.family == name] for name in names}


COLUMNS: dict[str, Callable[[Observation], str]] = {
    "case": lambda row: row.name,
    "what is stiff": lambda row: row.stiff,
    "must hold": lambda row: row.must,
    "outcome": lambda row: f"**{row.outcome}**" if row.outcome == "failed" else row.outcome,
    "measured>": lambda row: small(row.measured),
    "tolerance>": lambda row: small(row.tolerance),
    "how it was seen": lambda row: row.what,
}


def markdown(report: Report) -> str:
    """The page."""
    counts = {word: report.count(word) for word in WORDS}
    counted = ", ".join(f"{count} {word}" for word, count in counts.items() if count or word == "failed")
    sections = [
        "# Stability",
        f"Stiff and extreme cases, each with a property that must hold: {len(report.cases)} cases, {counted}.",
        "\n".join(f"- *{word}*: {meaning}" for word, meaning in WORDS.items()),
        "*Measured* must be at most its *tolerance*; what it is, and what it was compared with, stands beside it.\n"
        "Every case has been seen to fail with the product broken on purpose (`tests/unit/accuracy/mutants.py`).",
    ]
    for family, rows in report.families.items():
        sections += [f"## {family.capitalize()}", table(COLUMNS, rows)]
    sections += ["## How to make this page again", f"{report.measured.words()}. Each case has its seed in its code."]
    return "\n\n".join(sections) + "\n"


def write(report: Report, folder: Path) -> None:
    """Writes `stability.md` and `stability.json` into the folder, which is created if necessary."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stability.json").write_text(rows_as_json(report.model_dump(mode="json")), "utf-8")
    (folder / "stability.md").write_text(markdown(report), "utf-8")
