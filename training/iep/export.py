"""Writes the checkpoint of a finished training, its measurements, and the cards of the model and of its data;
measures a checkpoint again, from the text of a question to its answer, on scenes outside its training.
"""

import hashlib
import json
import platform
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scene_attack import disk
from scene_attack.analysis.verdict import wilson
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.color import from_bytes
from scene_attack.scenes.library import Library
from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.iep.assembly import Question, assemble
from scene_attack_questions.iep.checkpoint import HOW_TO_GET_WEIGHTS, Checkpoint, load, to_bytes
from scene_attack_questions.iep.engine import Engine
from scene_attack_questions.iep.program_generator import to_prefix
from scene_attack_questions.program import Program
from training.export import Written
from training.iep.data import BRIGHTER, COARSE, MOVED, TINTED, DataFolder, Images, Shard, examples_of
from training.iep.engine_training import execute
from training.iep.examples import Example
from training.iep.recipe import RECIPE, Split
from training.iep.stages import Stages
from training.loop import Said

OVERALL = "overall"


@dataclass(frozen=True)
class Share:
    """The share of right answers. interval: Wilson's, of 95 %."""

    right: int
    of: int

    @property
    def share(self) -> float:
        """In [0,1]."""
        return self.right / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Its ends."""
        return wilson(self.right, self.of)


@torch.no_grad()
def answers(engine: Engine, features: Tensor, examples: Sequence[Example], batch: int = 64) -> list[str]:
    """Returns the engine's answers, given the true programs; `features` as for `execute`."""
    engine.eval()
    words: list[str] = []
    for start in range(0, len(examples), batch):
        scores = execute(engine, features, examples[start : start + batch]).scores
        words += [ANSWERS[number] for number in scores.argmax(1).tolist()]
    return words


def by_family(examples: Sequence[Example], right: Sequence[bool]) -> dict[str, Share]:
    """Returns the shares of right answers overall and of each family, of one example at least."""
    families: dict[str, list[bool]] = {}
    for example, correct in zip(examples, right, strict=True):
        families.setdefault(example.family, []).append(correct)
    return {name: Share(sum(of), len(of)) for name, of in [(OVERALL, right), *sorted(families.items())]}


AT_ONCE = 20
"""Images that the network sees together, with all questions about them."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a question. group, renderer: those of its scene. right: the answer is right. program_right: the
    program is the true one, function by function."""

    example: Example
    group: str
    renderer: str
    right: bool
    program_right: bool


def outcomes(checkpoint: Checkpoint, data: DataFolder, split: Split, said: Said) -> list[Outcome]:
    """Returns the outcome of every question of a split."""
    rows: list[Outcome] = []
    pieces = data.pieces(split)
    for number, piece in enumerate(pieces):
        shard, part = data.read(piece), piece.part
        group = f"{part.objects[0]}-{part.objects[1]}"
        examples = list(examples_of([shard]))
        for example, (answer, program) in zip(examples, answered(checkpoint, shard, examples), strict=True):
            program_right = program is not None and to_prefix(program) == to_prefix(example.program)
            rows.append(Outcome(example, group, part.renderer, answer == example.answer, program_right))
        said("answering questions", number + 1, len(pieces), "")
    return rows


@torch.no_grad()
def answered(
    checkpoint: Checkpoint, shard: Shard, examples: Sequence[Example]
) -> list[tuple[str | None, Program | None]]:
    """Returns for each question about a shard's images the answer and the program; None where no program was made."""
    images = Images([shard])
    programs = checkpoint.generator.generate([example.text for example in examples])
    answers: dict[int, str] = {}
    for start in range(0, len(images), AT_ONCE):
        shown = range(start, min(start + AT_ONCE, len(images)))
        asked, questions = [], []
        for place, (example, program) in enumerate(zip(examples, programs, strict=True)):
            if example.image in shown and not isinstance(program, InvalidRequest):
                asked.append(place)
                questions.append(Question(program, example.image - start))
        if questions:
            seen = from_bytes(torch.from_numpy(images(shown)))
            scores = checkpoint.network(seen, assemble(questions)).scores
            answers |= {place: ANSWERS[best] for place, best in zip(asked, scores.argmax(1).tolist(), strict=True)}
    return [
        (answers.get(place), None if isinstance(program, InvalidRequest) else program)
        for place, program in enumerate(programs)
    ]


def figures(found: Sequence[Outcome]) -> dict[str, Any]:
    """Returns the shares of right answers by number of objects, each overall and by family; those by renderer; and the
    share of right programs."""
    groups = sorted({one.group for one in found}, key=lambda group: [int(end) for end in group.split("-")])
    return {
        "answers": {
            group: {
                name: _written(share)
                for name, share in by_family([one.example for one in own], [one.right for one in own]).items()
            }
            for group in groups
            if (own := [one for one in found if one.group == group])
        },
        "by_renderer": {
            name: _written(Share(sum(one.right for one in found if one.renderer == name), count))
            for name, count in sorted(Counter(one.renderer for one in found).items())
        },
        "programs": _written(Share(sum(one.program_right for one in found), len(found))),
    }


def disagreements(found: Mapping[str, Any], committed: Mapping[str, Any]) -> list[str]:
    """Returns a sentence for each share that is outside the committed 95 % interval, or that only one has."""
    ours, theirs = dict(_flat(found)), dict(_flat(committed))
    messages = [f"{name} is not in both" for name in sorted(set(ours) ^ set(theirs))]
    for name in sorted(set(ours) & set(theirs)):
        low, high = theirs[name]["wilson"]
        if not low <= ours[name]["share"] <= high:
            messages.append(f"{name} is {ours[name]['share']:.4f}, not within {low:.4f} and {high:.4f}")
    return messages


def _flat(value: Mapping[str, Any], name: str = "") -> list[tuple[str, Mapping[str, Any]]]:
    if "wilson" in value:
        return [(name, value)]
    return [pair for key, of in value.items() for pair in _flat(of, f"{name} {key}".strip())]


def _written(share: Share) -> dict[str, Any]:
    return {"right": share.right, "of": share.of, "share": share.share, "wilson": list(share.interval)}


NAME = "iep"
SHIPPED = Path(str(files("scene_attack_questions.iep"))) / f"{NAME}.safetensors"
"""The checkpoint that ships with the project."""


def write(stages: Stages, out: Path, command: str, said: Said) -> Written:
    """Measures a finished training on the validation and the test scenes and writes its files to `out`."""
    network, generator = stages.network, stages.generator
    for part in (network, generator):
        part.requires_grad_(False).eval()
    weights, data = out / f"{NAME}.safetensors", to_bytes(network, generator)
    disk.write(weights, data)
    checkpoint = load(weights)
    validation = outcomes(checkpoint, stages.data, "validation", said)
    before = figures(outcomes(Checkpoint(network, generator), stages.data, "test", said))
    checks = figures(outcomes(checkpoint, stages.data, "test", said))
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
        "validation": figures(validation),
        "check": checks,
        "before_quantisation": {group: of[OVERALL]["share"] for group, of in before["answers"].items()},
    }
    return Written.to(out, data, facts, {NAME: model_card(facts), "clevr-views": data_card(facts)}, table(checks))


@dataclass(frozen=True)
class Checked:
    """A checkpoint's results on the test scenes, as a table, and their differences from the committed figures."""

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
    trained = facts["recipe"]
    recipe = replace(RECIPE, shares=trained["shares"], scenes=trained["scenes"], questions=trained["questions"])
    data = DataFolder(folder / "data", recipe, facts["seed"])
    if not data.draw_missing(("test",), library, said, over, processes):
        return None
    checks = figures(outcomes(checkpoint, data, "test", said))
    return Checked(table(checks), disagreements(checks, facts["check"]))


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


PAPER = "96.9"
"""Percent of right answers of the published network on CLEVR's own test set, trained on all of its programs."""


def table(check: dict[str, Any]) -> str:
    """Returns a Markdown table of the figures of a check."""
    groups = list(check["answers"])
    heads = [f"{group} objects: right | of | % | 95 % interval" for group in groups]
    lines = [f"| questions | {' | '.join(heads)} |", "|---" * (1 + 4 * len(groups)) + "|"]
    for family in dict.fromkeys(name for group in groups for name in check["answers"][group]):
        cells = [_cells(check["answers"][group].get(family)) for group in groups]
        lines.append(f"| {family} | {' | '.join(cells)} |")
    return "\n".join(lines)


def model_card(facts: dict[str, Any]) -> str:
    """Returns the card of the trained network; `facts` are those that `export` writes beside the weights."""
    check = facts["check"]
    overall = {group: of[OVERALL] for group, of in check["answers"].items()}
    shares = " and ".join(f"{_percent(share['share'])} % with {group} objects" for group, share in overall.items())
    before = " and ".join(f"{_percent(share)} %" for share in facts["before_quantisation"].values())
    scenes = facts["recipe"]["scenes"]["train"]
    minutes = ", ".join(f"{name} {of:g}" for name, of in facts["minutes"].items())
    lines = [
        f"# {facts['name']}",
        "",
        "Answers questions about CLEVR-style scenes: inferring and executing programs (IEP, Johnson et al. 2017). A "
        "program generator turns the text of a question into a program, and an execution engine assembles modules by "
        "the program into a network over the features of the image. Trained from random weights on scenes drawn by "
        "the renderers that attack it.",
        "",
        f"**Right answers: {shares}**, from the text of the question to the answer, on scenes that played no part in "
        f"the training. Before the weights were rounded to 8 bits: {before}. The programs are right in "
        f"{_percent(check['programs']['share'])} % ({check['programs']['right']:,} of {check['programs']['of']:,}).",
        "",
        f"The published network reaches {PAPER} % on CLEVR's own test set, other scenes and questions than these, so "
        "the figures cannot be compared as equals.",
        "",
        table(check),
        "",
        "The intervals are Wilson's and take questions as independent. Questions about one scene are not, so they are "
        "somewhat too narrow.",
        "",
        "| renderer | right | of | % | 95 % interval |",
        "|---|---|---|---|---|",
        *(f"| {name} | {_cells(share)} |" for name, share in check["by_renderer"].items()),
        "",
        "`python -m training iep --check` measures this again.",
        "",
        "## Departures from the published network",
        "",
        "The trunk is a small one trained here, not ResNet-101's first stages. Modules are 1×1 convolutions, not 3×3, "
        "take coordinates and what their inputs attend to, and see the 64 cells that are likeliest to hold an object. "
        "A set or an object passes between modules as its mask. Masks, counts and queries inside a program are "
        "supervised, and the trunk is trained on places and attributes of objects before the engine, then frozen.",
        "",
        "## Training",
        "",
        f"    {facts['command']}",
        "",
        f"Seed {facts['seed']}, {scenes:,} scenes, {facts['recipe']['questions']} questions about each; minutes of "
        f"training: {minutes}. Python {facts['python']}, torch {facts['torch']}. With the same data, machine and "
        "number of threads a training is reproducible bit for bit.",
        "",
        "Recipe: " + ", ".join(f"{key} {value}" for key, value in facts["recipe"].items()) + ".",
        "",
        f"Weights: {facts['bytes'] / 1e6:.1f} MB, 8 bits per weight with one scale for each output of each module, "
        f"SHA-256 `{facts['sha256']}`. Data: see clevr-views.md.",
    ]
    return "\n".join(lines) + "\n"


def data_card(facts: dict[str, Any]) -> str:
    """Returns the card of the scenes and questions."""
    recipe = facts["recipe"]
    shares = ", ".join(f"{share:.0%} {name}" for name, share in recipe["shares"].items())
    splits = {
        "train": ("3 to 10", recipe["scenes"]["train"]),
        "validation": ("3 to 10", recipe["scenes"]["validation"]),
        "test": ("3 to 6, and as many with 3 to 10", 2 * recipe["scenes"]["test"]),
    }
    lines = [
        "# Views of CLEVR-style scenes",
        "",
        "Scenes after CLEVR (Johnson et al. 2017), made by `scene_attack_questions.clevr.generator`: cubes, spheres "
        "and cylinders of two sizes, eight colours, rubber and metal on a floor, with jittered camera and lights. "
        f"Questions are of the {len(FAMILIES)} families of `scene_attack_questions`, {recipe['questions']} about each "
        "scene, balanced over families, functions and answers in each file of data.",
        "",
        "| split | scenes | objects | SHA-256 |",
        "|---|---|---|---|",
        *(
            f"| {split} | {count:,} | {objects} | `{facts['data'][split]}` |"
            for split, (objects, count) in splits.items()
        ),
        "",
        f"**Images.** 240 × 320 pixels, 8 bits, with floor, given surfaces and shadows. Drawn by {shares}. The seeds "
        "of the splits differ, so that no scene is in two of them; the test scenes played no part in the training.",
        "",
        f"**Variation.** {recipe['varied']:.0%} of the training scenes have lights, colours and surfaces changed as "
        f"attacks change them: energies by a factor with a standard deviation of {BRIGHTER} of its logarithm, "
        f"positions by {MOVED} a coordinate, colours by {TINTED} a channel, the environment map turned. Their answers "
        f"stay the same. Shadows of training scenes have {COARSE['samples']} samples of each light, or "
        f"{COARSE['texel_samples']} of each texel of the environment map. The trunk sees images mirrored, brighter or "
        "darker, and tinted.",
        "",
        "**Limits.** Everything is drawn: the network knows nothing of photographs, nor of CLEVR's own images, whose "
        "light and surfaces are Blender's.",
    ]
    return "\n".join(lines) + "\n"


def _cells(share: dict[str, Any] | None) -> str:
    if share is None:
        return "| | |"
    low, high = share["wilson"]
    return f"{share['right']:,} | {share['of']:,} | {_percent(share['share'])} | {_percent(low)} to {_percent(high)}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
