"""Writes the study's page and its curves from the records in a folder. No figure of the page is typed by hand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.study import curves, equal_p, examples, reasons, tables
from benchmarks.study.record import Record, load

TEXT = Path(__file__).with_name("classification.md")
"""The hand-written text, with the places of tables and curves as {{name}}."""
FOLDER = Path(__file__).parents[2] / "docs" / "study"
PAGE = "classification.md"
DIFFERENTIABLE, NONDIFFERENTIABLE, LITE0 = "differentiable", "nondifferentiable", "lite0"
EQUAL_P = "equal-p"
NAMES = (DIFFERENTIABLE, LITE0, NONDIFFERENTIABLE, EQUAL_P)
"""The records by the names of their files; each is of the campaign examples/paper-<name>.json."""
WITH_EXAMPLES = (DIFFERENTIABLE, NONDIFFERENTIABLE)
"""The campaigns of which examples are shown."""


@dataclass(frozen=True)
class Study:
    """The results in a folder: the records that are there, and the examples."""

    records: Mapping[str, Record]
    examples: list[examples.Example]

    @classmethod
    def of(cls, folder: Path) -> "Study":
        """Reads a folder. Raises FileNotFoundError if there is no record in it."""
        paths = {name: folder / f"{name}.json" for name in NAMES}
        records = {name: load(path) for name, path in paths.items() if path.exists()}
        if not records:
            raise FileNotFoundError(f"{folder} has none of {', '.join(path.name for path in paths.values())}")
        return cls(records, examples.load(folder))

    @property
    def differentiable(self) -> list[Record]:
        """The records of the first table."""
        return [self.records[name] for name in (DIFFERENTIABLE, LITE0) if name in self.records]


def files(folder: Path) -> dict[str, str]:
    """The text of every file that follows from the results in a folder, by its name: the page and the curves."""
    study = Study.of(folder)
    charts = _charts(study)
    text = TEXT.read_text("utf-8")
    for name, part in _PARTS.items():
        mark = "{{" + name + "}}"
        if text.count(mark) != 1:
            raise ValueError(f"{TEXT.name} must have {mark} once")
        text = text.replace(mark, _part(study, part))
    return {PAGE: text, **charts}


def write(folder: Path) -> list[Path]:
    """Writes these files and returns their paths."""
    texts = files(folder)
    for name, text in texts.items():
        (folder / name).write_text(text, "utf-8")
    return [folder / name for name in texts]


def _part(study: Study, part: "Part") -> str:
    """A part of the page; it names the campaigns of its records that have not been run, of which it has no figure."""
    missing = [f"`examples/paper-{name}.json`" for name in part.records if name not in study.records]
    said = f"*Not run yet: {' and '.join(missing)}.*" if missing else ""
    return "\n\n".join(one for one in (said if part.says else "", part.write(study)) if one)


def _charts(study: Study) -> dict[str, str]:
    return {
        _chart(name, target): _CURVES[name](record, target)
        for name, record in study.records.items()
        for target in record.table().targets
    }


def _chart(name: str, target: str) -> str:
    return f"{name}-{target}.svg"


def _if_any(write: Callable[[list[Record]], str]) -> Callable[[Study], str]:
    """A part of the records of the first table; empty if there is none."""
    return lambda study: write(study.differentiable) if study.differentiable else ""


def _one(name: str, write: Callable[[Record], str]) -> Callable[[Study], str]:
    """A part of one record; empty if it is missing."""
    return lambda study: write(study.records[name]) if name in study.records else ""


def _images(study: Study, *names: str) -> str:
    return "\n\n".join(
        f"![{tables.title(target)}: successes against work, and mean curves]({_chart(name, target)})"
        for name in names
        if name in study.records
        for target in study.records[name].table().targets
    )


def _orders(study: Study) -> str:
    return "\n".join(
        f"- {tables.orders(record, target)}" for record in study.differentiable for target in record.table().targets
    )


def _examples(study: Study) -> str:
    if not study.examples:
        return ""
    rows = []
    for one in study.examples:
        what = f"{tables.title(one.target)}, {one.attack}"
        said = f"{one.before}, {one.before_confidence:.0%}", f"**{one.after}**, {one.after_confidence:.0%}"
        notes = (*said, f"{what}<br>p {1e3 * one.p:.1f}")
        images = (f"![{text}]({one.name}-{text}.png)" for text in examples.IMAGES.values())
        rows.append([f"{image}<br>{note}" for image, note in zip(images, notes, strict=True)])
    creators = sorted({credit for one in study.examples for credit in one.credits})
    table = "\n".join(
        "| " + " | ".join(cells) + " |"
        for cells in (("before", "attacked, rendered afresh", "difference ×5"), (":---:",) * 3, *rows)
    )
    return f"{table}\n\n<small>{'; '.join(creators)}</small>"


def _foot(study: Study) -> str:
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


_CURVES: dict[str, Callable[[Record, str], str]] = {
    DIFFERENTIABLE: curves.differentiable,
    LITE0: curves.differentiable,
    NONDIFFERENTIABLE: curves.nondifferentiable,
    EQUAL_P: equal_p.draw,
}


@dataclass(frozen=True)
class Part:
    """A part of the page, and the records that it is written from."""

    write: Callable[[Study], str]
    records: tuple[str, ...] = ()
    says: bool = True
    """Whether it says which of these are missing; of several parts in a row of the same records the first does."""


_BOTH = (DIFFERENTIABLE, LITE0)
_PARTS = {
    "views": Part(lambda study: tables.views(list(study.records.values()))),
    "differentiable": Part(_if_any(tables.differentiable), _BOTH),
    "orders": Part(_orders, _BOTH, says=False),
    "differentiable curves": Part(lambda study: _images(study, *_BOTH), _BOTH, says=False),
    "coverage": Part(_if_any(reasons.by_coverage), _BOTH, says=False),
    "confidence": Part(_if_any(reasons.by_confidence), _BOTH, says=False),
    "work": Part(_if_any(tables.work), _BOTH, says=False),
    "nondifferentiable": Part(_one(NONDIFFERENTIABLE, tables.nondifferentiable), (NONDIFFERENTIABLE,)),
    "nondifferentiable curves": Part(lambda study: _images(study, NONDIFFERENTIABLE), (NONDIFFERENTIABLE,), says=False),
    "equal p": Part(_one(EQUAL_P, equal_p.section), (EQUAL_P,)),
    "examples": Part(_examples),
    "foot": Part(_foot),
}
