"""The study's two pages: the paper's object classification on furniture (section 4.1), and its visual question
answering on scenes after CLEVR (section 4.2).

The parts of a page are written from the records in a folder. No figure is typed by hand.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.study import curves, equal_p, examples, tables
from benchmarks.study.record import Record, load


@dataclass(frozen=True)
class Study:
    """The results of a page in a folder: the records that are there, and the examples."""

    records: Mapping[str, Record]
    examples: list[examples.Example]


@dataclass(frozen=True)
class Part:
    """A part of a page, and the records that it is written from."""

    write: Callable[[Study], str]
    records: tuple[str, ...] = ()
    says: bool = True
    """Whether it says which of these are missing; of several parts in a row of the same records the first does."""


@dataclass(frozen=True)
class Page:
    """A page of docs/study and its curves.

    name: of the page, and of the hand-written text beside this file, with the places of the parts as {{name}}.
    curves: the records by the names of their files, each of the campaign examples/paper-<name>.json, with what draws
    the curves of a record and a network. with_examples: the campaigns of which examples are shown. parts: by name.
    """

    name: str
    curves: Mapping[str, Callable[[Record, str], str]]
    with_examples: tuple[str, ...]
    parts: Mapping[str, Part]

    def study(self, folder: Path) -> Study:
        """Reads a folder. Raises FileNotFoundError if it has none of the page's records."""
        paths = {name: folder / f"{name}.json" for name in self.curves}
        records = {name: load(path) for name, path in paths.items() if path.exists()}
        if not records:
            raise FileNotFoundError(f"{folder} has none of {', '.join(path.name for path in paths.values())}")
        return Study(records, [one for one in examples.load(folder) if one.campaign in self.with_examples])

    def files(self, folder: Path) -> dict[str, str]:
        """The text of every file that follows from the results in a folder, by its name: the page and the curves.

        Raises as `study` does.
        """
        study = self.study(folder)
        text = Path(__file__).with_name(self.name).read_text("utf-8")
        for name, part in self.parts.items():
            mark = "{{" + name + "}}"
            if text.count(mark) != 1:
                raise ValueError(f"{self.name} must have {mark} once")
            text = text.replace(mark, _part(study, part))
        charts = {
            chart(name, target): self.curves[name](record, target)
            for name, record in study.records.items()
            for target in record.table().targets
        }
        return {self.name: text, **charts}


def _part(study: Study, part: Part) -> str:
    """A part of the page; it names the campaigns of its records that have not been run, of which it has no figure."""
    missing = [f"`examples/paper-{name}.json`" for name in part.records if name not in study.records]
    said = f"*Not run yet: {' and '.join(missing)}.*" if missing else ""
    return "\n\n".join(one for one in (said if part.says else "", part.write(study)) if one)


def chart(name: str, target: str) -> str:
    """The name of the file of a record's and network's curves."""
    return f"{name}-{target}.svg"


def of_one(name: str, write: Callable[[Record], str]) -> Callable[[Study], str]:
    """A part of one record; empty if it is missing."""
    return lambda study: write(study.records[name]) if name in study.records else ""


def curves_of(*names: str) -> Callable[[Study], str]:
    """The curves of these records."""
    return lambda study: "\n\n".join(
        f"![{tables.title(target)}: successes against work, and mean curves]({chart(name, target)})"
        for name in names
        if name in study.records
        for target in study.records[name].table().targets
    )


def shown(study: Study) -> str:
    """The examples: a row of three images for each, with the answers before and after."""
    if not study.examples:
        return ""
    rows = []
    for one in study.examples:
        images = (f"![{text}]({one.name}-{text}.png)" for text in examples.IMAGES.values())
        rows.append([f"{image}<br>{note}" for image, note in zip(images, _notes(one), strict=True)])
    creators = sorted({credit for one in study.examples for credit in one.credits})
    table = "\n".join(
        "| " + " | ".join(cells) + " |"
        for cells in (("before", "attacked, rendered afresh", "difference ×5"), (":---:",) * 3, *rows)
    )
    return f"{table}\n\n<small>{'; '.join(creators)}</small>" if creators else table


def _notes(one: examples.Example) -> tuple[str, str, str]:
    """What stands below the images of an example: the answers before, those after, and the attack."""
    about = f"{tables.title(one.target)}, {one.attack}<br>p {1e3 * one.p:.1f}"
    if not one.questions:
        return f"{one.before}, {one.before_confidence:.0%}", f"**{one.after}**, {one.after_confidence:.0%}", about
    before = (f"{asked.question} {asked.before}, {asked.before_confidence:.0%}" for asked in one.questions)
    after = (f"**{asked.after}**, {asked.after_confidence:.0%}" for asked in one.questions)
    return "<br>".join(before), "<br>".join(after), about


def foot(study: Study) -> str:
    """The provenance of each record, and the commands."""
    blocks = []
    for name, record in study.records.items():
        versions = ", ".join(f"{package} {number}" for package, number in record.versions.items())
        weights = ", ".join(f"{target} {digest[:12]}" for target, digest in record.weights.items())
        seconds = sum(job.seconds or 0.0 for job in record.jobs)
        seeds = ", ".join(map(str, sorted({job.seed for job in record.jobs})))
        failed = sum(job.state != "succeeded" for job in record.jobs)
        blocks.append(
            f"- [{name}.json]({name}.json): `{record.command}`, seed {seeds}; {len(record.jobs):,} jobs, {failed} of "
            f"them failed, {seconds / 3600:.1f} hours of attacks. {'; '.join(record.backends)}. {versions}. Weights "
            f"{weights}. "
            f"{record.machine}."
        )
    return "\n".join(
        [*blocks, "", "`python -m benchmarks.study record FOLDER NAME` makes a record of a campaign's folder, "
         "`python -m benchmarks.study page` writes this page."]
    )  # fmt: skip


DIFFERENTIABLE, NONDIFFERENTIABLE, LITE0 = "differentiable", "nondifferentiable", "lite0"
EQUAL_P = "equal-p"
_BOTH = (DIFFERENTIABLE, LITE0)
"""The records of the first table."""


def _if_any(write: Callable[[list[Record]], str]) -> Callable[[Study], str]:
    """A part of the records of the first table; empty if there is none."""

    def part(study: Study) -> str:
        found = [study.records[name] for name in _BOTH if name in study.records]
        return write(found) if found else ""

    return part


def _orders(records: list[Record]) -> str:
    return "\n".join(f"- {tables.orders(record, target)}" for record in records for target in record.table().targets)


CLASSIFICATION = Page(
    name="classification.md",
    curves={
        DIFFERENTIABLE: curves.differentiable,
        LITE0: curves.differentiable,
        NONDIFFERENTIABLE: curves.nondifferentiable,
        EQUAL_P: equal_p.draw,
    },
    with_examples=(DIFFERENTIABLE, NONDIFFERENTIABLE),
    parts={
        "views": Part(lambda study: tables.views(list(study.records.values()))),
        "differentiable": Part(_if_any(tables.differentiable), _BOTH),
        "orders": Part(_if_any(_orders), _BOTH, says=False),
        "differentiable curves": Part(curves_of(*_BOTH), _BOTH, says=False),
        "coverage": Part(_if_any(tables.by_coverage), _BOTH, says=False),
        "confidence": Part(_if_any(tables.by_confidence), _BOTH, says=False),
        "work": Part(_if_any(tables.work), _BOTH, says=False),
        "nondifferentiable": Part(of_one(NONDIFFERENTIABLE, tables.nondifferentiable), (NONDIFFERENTIABLE,)),
        "nondifferentiable curves": Part(curves_of(NONDIFFERENTIABLE), (NONDIFFERENTIABLE,), says=False),
        "equal p": Part(of_one(EQUAL_P, equal_p.section), (EQUAL_P,)),
        "examples": Part(shown),
        "foot": Part(foot),
    },
)


VQA_DIFFERENTIABLE, VQA_NONDIFFERENTIABLE = "vqa-differentiable", "vqa-nondifferentiable"
_FIRST, _SECOND = (VQA_DIFFERENTIABLE,), (VQA_NONDIFFERENTIABLE,)


def _vqa_differentiable(record: Record) -> str:
    return tables.differentiable([record], tables.VQA)


def _vqa_orders(record: Record) -> str:
    return "\n".join(f"- {tables.orders(record, target)}" for target in record.table().targets)


def _vqa_nondifferentiable(record: Record) -> str:
    return tables.nondifferentiable(record, tables.VQA)


VQA = Page(
    name="vqa.md",
    curves={VQA_DIFFERENTIABLE: curves.questions, VQA_NONDIFFERENTIABLE: curves.nondifferentiable},
    with_examples=(VQA_DIFFERENTIABLE, VQA_NONDIFFERENTIABLE),
    parts={
        "views": Part(lambda study: tables.views(list(study.records.values()), of="scenes")),
        "differentiable": Part(of_one(VQA_DIFFERENTIABLE, _vqa_differentiable), _FIRST),
        "orders": Part(of_one(VQA_DIFFERENTIABLE, _vqa_orders), _FIRST, says=False),
        "differentiable curves": Part(curves_of(VQA_DIFFERENTIABLE), _FIRST, says=False),
        "confidence": Part(
            of_one(VQA_DIFFERENTIABLE, lambda record: tables.by_confidence([record])), _FIRST, says=False
        ),
        "nondifferentiable": Part(of_one(VQA_NONDIFFERENTIABLE, _vqa_nondifferentiable), _SECOND),
        "nondifferentiable curves": Part(curves_of(VQA_NONDIFFERENTIABLE), _SECOND, says=False),
        "questions": Part(of_one(VQA_DIFFERENTIABLE, tables.by_question), _FIRST),
        "questions nondifferentiable": Part(of_one(VQA_NONDIFFERENTIABLE, tables.by_question), _SECOND),
        "kinds": Part(of_one(VQA_DIFFERENTIABLE, tables.left_kind), _FIRST),
        "kinds nondifferentiable": Part(of_one(VQA_NONDIFFERENTIABLE, tables.left_kind), _SECOND, says=False),
        "modules": Part(of_one(VQA_DIFFERENTIABLE, tables.fooled_first), _FIRST),
        "modules nondifferentiable": Part(of_one(VQA_NONDIFFERENTIABLE, tables.fooled_first), _SECOND, says=False),
        "examples": Part(shown),
        "foot": Part(foot),
    },
)


FOLDER = Path(__file__).parents[2] / "docs" / "study"
PAGES = (CLASSIFICATION, VQA)
NAMES = tuple(name for page in PAGES for name in page.curves)
"""The records by the names of their files."""
WITH_EXAMPLES = tuple(name for page in PAGES for name in page.with_examples)


def write(folder: Path) -> list[Path]:
    """Writes the pages that have a record in a folder, with their curves, and returns the paths of these files."""
    written = []
    for page in PAGES:
        if any((folder / f"{name}.json").exists() for name in page.curves):
            for name, text in page.files(folder).items():
                (folder / name).write_text(text, "utf-8")
                written.append(folder / name)
    return written
