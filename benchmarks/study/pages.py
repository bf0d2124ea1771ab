"""The study's three pages: the paper's object classification on furniture (section 4.1), its visual question
answering on scenes after CLEVR (section 4.2), and the changes that a thing, a lamp and a camera could have.

The parts of a page are written from the records in a folder. No figure is typed by hand.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.study import curves, equal_p, examples, one_look, physical, survival, tables
from benchmarks.study.record import Record, load


@dataclass(frozen=True)
class Study:
    """The results of a page in a folder: the records that are there, and the examples."""

    records: Mapping[str, Record]
    examples: list[examples.Example]


@dataclass(frozen=True)
class Page:
    """A page of docs/study and its curves.

    name: of the page, and of the hand-written text beside this file, with the places of the parts as {{name}}.
    curves: the records by the names of their files, each of the campaign examples/paper-<name>.json, with what draws
    the curves of a record and a network, or None where the page has none. with_examples: the campaigns of which
    examples are shown. parts: by name.
    """

    name: str
    curves: Mapping[str, Callable[[Record, str], str] | None]
    with_examples: tuple[str, ...]
    parts: Mapping[str, Callable[[Study], str]]

    def files(self, folder: Path) -> dict[str, str]:
        """The text of every file that follows from the results in a folder, by its name: the page and the curves.

        Raises FileNotFoundError if a record is missing.
        """
        records = {name: load(folder / f"{name}.json") for name in self.curves}
        study = Study(records, examples.load(folder))
        text = Path(__file__).with_name(self.name).read_text("utf-8")
        for name, part in self.parts.items():
            mark = "{{" + name + "}}"
            if text.count(mark) != 1:
                raise ValueError(f"{self.name} must have {mark} once")
            text = text.replace(mark, part(study))
        charts = {
            chart(name, target): draw(records[name], target)
            for name, draw in self.curves.items()
            if draw is not None
            for target in records[name].table().targets
        }
        return {self.name: text, **charts}


def chart(name: str, target: str) -> str:
    """The name of the file of a record's and network's curves."""
    return f"{name}-{target}.svg"


def of(name: str, write: Callable[[Record], str]) -> Callable[[Study], str]:
    """A part of one record."""
    return lambda study: write(study.records[name])


def of_all(names: Sequence[str], write: Callable[[Sequence[Record]], str]) -> Callable[[Study], str]:
    """A part of several records."""
    return lambda study: write([study.records[name] for name in names])


def of_examples(campaigns: Sequence[str], write: Callable[[Sequence[examples.Example]], str]) -> Callable[[Study], str]:
    """A part of the examples of several campaigns."""
    return lambda study: write([example for example in study.examples if example.campaign in campaigns])


def curves_of(*names: str) -> Callable[[Study], str]:
    """The curves of these records."""
    return lambda study: "\n\n".join(
        f"![{tables.title(target)}: the curves of {name}]({chart(name, target)})"
        for name in names
        for target in study.records[name].table().targets
    )


def shown(chosen: Sequence[examples.Example]) -> str:
    """Examples: a row of three images for each, with the answers before and after."""
    if not chosen:
        return ""
    rows = []
    for example in chosen:
        images = (f"![{text}]({example.name}-{text}.png)" for text in examples.IMAGES.values())
        rows.append([f"{image}<br>{note}" for image, note in zip(images, _notes(example), strict=True)])
    creators = sorted({credit for example in chosen for credit in example.credits})
    table = "\n".join(
        "| " + " | ".join(cells) + " |"
        for cells in (("before", "attacked, rendered afresh", "difference ×5"), (":---:",) * 3, *rows)
    )
    words = (f"- {example.attack}: {'; '.join(example.words)}." for example in chosen if example.words)
    small = f"<small>{'; '.join(creators)}</small>" if creators else ""
    return "\n\n".join(part for part in (table, "\n".join(words), small) if part)


def _notes(example: examples.Example) -> tuple[str, str, str]:
    """Notes below the images of an example: the answers before, those after, and the attack."""
    about = f"{tables.title(example.target)}, {example.attack}<br>p {1e3 * example.p:.1f}"
    if not example.questions:
        return (
            f"{example.before}, {example.before_confidence:.0%}",
            f"**{example.after}**, {example.after_confidence:.0%}",
            about,
        )
    before = (f"{asked.question} {asked.before}, {asked.before_confidence:.0%}" for asked in example.questions)
    after = (f"**{asked.after}**, {asked.after_confidence:.0%}" for asked in example.questions)
    return "<br>".join(before), "<br>".join(after), about


def foot(study: Study) -> str:
    """The provenance of each record, and the commands."""
    blocks = []
    for name, record in study.records.items():
        versions = ", ".join(f"{package} {number}" for package, number in record.versions.items())
        weights = ", ".join(f"{target} {digest[:12]}" for target, digest in record.weights.items())
        seeds = ", ".join(map(str, sorted({job.seed for job in record.jobs})))
        failed = sum(job.state != "succeeded" for job in record.jobs)
        blocks.append(
            f"- [{name}.json]({name}.json): `{record.command}`, seed {seeds}; {len(record.jobs):,} jobs, {failed} of "
            f"them failed. {'; '.join(record.backends)}. {versions}. Weights {weights}. {record.machine}."
        )
    return "\n".join(
        [*blocks, "", "`python -m benchmarks.study record FOLDER NAME` makes a record of a campaign's folder, "
         "`python -m benchmarks.study page` writes this page."]
    )  # fmt: skip


FIRST = ("differentiable", "lite0")
"""The records of the first table."""
ONE_LOOK = ("one-look-alexnet", "one-look-resnet34")
"""The records of networks that know one look, beside those that ship."""
CLASSIFICATION = Page(
    name="classification.md",
    curves={
        "differentiable": curves.differentiable,
        "lite0": curves.differentiable,
        "nondifferentiable": curves.nondifferentiable,
        "blender": curves.nondifferentiable,
        "equal-p": equal_p.draw,
        "tolerances": curves.differentiable,
        **dict.fromkeys(ONE_LOOK),
    },
    with_examples=("differentiable", "nondifferentiable", "blender"),
    parts={
        # The campaign of tolerances takes each view three times.
        "views": of_all(("differentiable", "lite0", "nondifferentiable", "blender", "equal-p"), tables.views),
        "differentiable": of_all(FIRST, tables.differentiable),
        "orders": of_all(FIRST, tables.orders),
        "differentiable curves": curves_of(*FIRST),
        "coverage": of_all(FIRST, tables.by_coverage),
        "confidence": of_all(FIRST, tables.by_confidence),
        "work": of_all(FIRST, tables.work),
        "nondifferentiable": of("nondifferentiable", tables.nondifferentiable),
        "nondifferentiable curves": curves_of("nondifferentiable"),
        "blender": of("blender", tables.nondifferentiable),
        "blender curves": curves_of("blender"),
        "blender example": of_examples(["blender"], shown),
        "equal p": of("equal-p", equal_p.section),
        "one look views": of_all(ONE_LOOK, tables.views),
        "one look": of_all((*ONE_LOOK, "differentiable"), one_look.light_and_material),
        "tolerances": of_all(["tolerances"], tables.work),
        "tolerance curves": curves_of("tolerances"),
        "examples": of_examples(["differentiable", "nondifferentiable"], shown),
        "foot": foot,
    },
)
THROUGH_TORCH, THROUGH_PYRENDER = "vqa-differentiable", "vqa-nondifferentiable"
VQA = Page(
    name="vqa.md",
    curves={THROUGH_TORCH: curves.questions, THROUGH_PYRENDER: curves.nondifferentiable},
    with_examples=(THROUGH_TORCH, THROUGH_PYRENDER),
    parts={
        "views": lambda study: tables.views(list(study.records.values()), of="scenes"),
        "differentiable": of_all([THROUGH_TORCH], partial(tables.differentiable, task=tables.VQA)),
        "orders": of_all([THROUGH_TORCH], tables.orders),
        "differentiable curves": curves_of(THROUGH_TORCH),
        "confidence": of_all([THROUGH_TORCH], tables.by_confidence),
        "nondifferentiable": of(THROUGH_PYRENDER, partial(tables.nondifferentiable, task=tables.VQA)),
        "nondifferentiable curves": curves_of(THROUGH_PYRENDER),
        "questions": of(THROUGH_TORCH, tables.by_question),
        "questions nondifferentiable": of(THROUGH_PYRENDER, tables.by_question),
        "kinds": of(THROUGH_TORCH, tables.left_kind),
        "kinds nondifferentiable": of(THROUGH_PYRENDER, tables.left_kind),
        "modules": of(THROUGH_TORCH, tables.fooled_first),
        "modules nondifferentiable": of(THROUGH_PYRENDER, tables.fooled_first),
        "examples": of_examples([THROUGH_TORCH, THROUGH_PYRENDER], shown),
        "foot": foot,
    },
)
DRAWN = ("physical", "physical-lite0")
"""The records of several changes, whose curves are compared."""
CHANGES = (*DRAWN, "pose")
"""The records of the table of changes."""
PHYSICAL = Page(
    name="physical.md",
    curves=dict.fromkeys(DRAWN, curves.changes) | {"pose": None, "around": curves.around},
    with_examples=("physical",),
    parts={
        "views": of_all(CHANGES, tables.views),
        "changes": of_all(CHANGES, physical.changes),
        "change curves": curves_of(*DRAWN),
        "coverage": of_all(CHANGES, physical.by_coverage),
        "wavelengths": of("physical", physical.by_wavelength),
        "around": of("around", physical.around),
        "around curves": curves_of("around"),
        "examples": of_examples(["physical"], shown),
        "foot": foot,
    },
)


OPINION = "second-opinion"
SURVIVAL = Page(
    name="survival.md",
    curves={"survival": None, OPINION: None},
    with_examples=(OPINION,),
    parts={
        "views": of_all(("survival", OPINION), tables.views),
        "cameras": of("survival", survival.before_cameras),
        "others": of(OPINION, survival.drawn_by_others),
        "pictures": of_examples([OPINION], survival.pictures),
        "foot": foot,
    },
)


FOLDER = Path(__file__).parents[2] / "docs" / "study"
PAGES = (CLASSIFICATION, VQA, PHYSICAL, SURVIVAL)
NAMES = tuple(name for page in PAGES for name in page.curves)
"""The records by the names of their files."""
WITH_EXAMPLES = tuple(name for page in PAGES for name in page.with_examples)


def write(folder: Path) -> list[Path]:
    """Writes the pages of a folder with their curves, and returns the paths of these files."""
    written = {folder / name: text for page in PAGES for name, text in page.files(folder).items()}
    for path, text in written.items():
        path.write_text(text, "utf-8")
    return list(written)
