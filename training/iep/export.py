"""Writes the checkpoint of a finished training, what was measured of it, and the cards of the model and of its data;
measures a checkpoint again."""

import hashlib
import json
import platform
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch

from services import disk
from services.errors import InvalidRequest
from services.scenes.library import Library
from services.targets.iep.checkpoint import HOW_TO_GET_WEIGHTS, Checkpoint, load, to_bytes
from training.iep import checking
from training.iep.cards import data_card, model_card, table
from training.iep.data import DataFolder, Said
from training.iep.metrics import OVERALL
from training.iep.recipe import RECIPE
from training.iep.stages import Stages

NAME = "iep"
SHIPPED = Path(str(files("services.targets").joinpath("weights"))) / f"{NAME}.safetensors"
"""The checkpoint that ships with the project."""


@dataclass(frozen=True)
class Written:
    """The files that were written, and the result as a table."""

    weights: Path
    facts: Path
    card: Path
    data_card: Path
    summary: str


def write(stages: Stages, out: Path, command: str, said: Said) -> Written:
    """Measures a finished training on the validation and the test scenes and writes its files to `out`."""
    network, generator = stages.network, stages.generator
    for part in (network, generator):
        part.requires_grad_(False).eval()
    weights, data = out / f"{NAME}.safetensors", to_bytes(network, generator)
    disk.write(weights, data)
    checkpoint = load(weights)
    validation = checking.outcomes(checkpoint, stages.data, "validation", said)
    before = checking.figures(checking.outcomes(Checkpoint(network, generator), stages.data, "test", said))
    found = checking.figures(checking.outcomes(checkpoint, stages.data, "test", said))
    facts = {
        "name": NAME,
        "sha256": hashlib.sha256(data).hexdigest(),
        "bytes": len(data),
        "command": command,
        "recipe": stages.recipe.written(),
        "seed": stages.seed,
        "minutes": {name: round(seconds / 60, 1) for name, seconds in stages.seconds.items()},
        "data": {split: stages.data.digest(split) for split in stages.recipe.scenes},
        "torch": torch.__version__,
        "python": platform.python_version(),
        "validation": checking.figures(validation),
        "check": found,
        "before_quantisation": {group: of[OVERALL]["share"] for group, of in before["answers"].items()},
    }
    written = Written(weights, out / f"{NAME}.json", out / f"{NAME}.md", out / "clevr-views.md", table(found))
    disk.write(written.facts, (json.dumps(facts, indent=1) + "\n").encode())
    disk.write(written.card, model_card(facts).encode())
    disk.write(written.data_card, data_card(facts).encode())
    return written


@dataclass(frozen=True)
class Checked:
    """What a checkpoint does on the test scenes, as a table, and where that differs from the committed figures."""

    summary: str
    disagreements: list[str]


def check(
    weights: Path, folder: Path, library: Library, said: Said, over: Callable[[], bool], processes: int = 1
) -> Checked | None:
    """Measures a checkpoint, and compares with the figures in the `.json` file beside it; None if it is over before.

    The test scenes are drawn into `folder` by so many processes where they are not there. Raises
    InvalidRequest("--weights") for a file that is missing or damaged, or whose figures are those of another, and as
    `DataFolder.draw_missing` does.
    """
    facts = _facts(weights, folder.parent)
    try:
        checkpoint = load(weights)
    except ValueError as error:
        raise InvalidRequest("--weights", str(error)) from error
    given = facts["recipe"]
    recipe = replace(RECIPE, shares=given["shares"], scenes=given["scenes"], questions=given["questions"])
    data = DataFolder(folder / "data", recipe, facts["seed"])
    if not data.draw_missing(("test",), library, said, over, processes):
        return None
    found = checking.figures(checking.outcomes(checkpoint, data, "test", said))
    return Checked(table(found), checking.disagreements(found, facts["check"]))


def _facts(weights: Path, out: Path) -> dict[str, Any]:
    """Reads the figures beside a checkpoint. out: where a training writes to, for the message if the file is not there.

    Raises InvalidRequest("--weights") as `check` does.
    """
    path = weights.with_suffix(".json")
    if not weights.is_file():
        own = out / weights.name
        how = f"give those of a training of yours: --weights {own}" if own.is_file() else HOW_TO_GET_WEIGHTS
        raise InvalidRequest("--weights", f"there is no file {weights}; {how}")
    if not path.is_file():
        raise InvalidRequest(
            "--weights", f"{path} is not there, which has the figures to compare with; a training writes both files"
        )
    try:
        facts: dict[str, Any] = json.loads(path.read_text("utf-8"))
        sha256 = hashlib.sha256(weights.read_bytes()).hexdigest()
    except (OSError, ValueError) as error:
        raise InvalidRequest("--weights", f"{weights} or {path.name} cannot be read: {error}") from error
    if facts.get("sha256") != sha256:
        raise InvalidRequest("--weights", f"{weights} is damaged or not the file that {path.name} is about")
    return facts
