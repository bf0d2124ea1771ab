"""The page of the paper's study of object classification (section 4.1), on furniture."""

from collections.abc import Callable

from benchmarks.study import curves, equal_p, reasons, tables
from benchmarks.study.page import Page, Part, Study, curves_of, foot, of_one, shown
from benchmarks.study.record import Record

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
        "coverage": Part(_if_any(reasons.by_coverage), _BOTH, says=False),
        "confidence": Part(_if_any(reasons.by_confidence), _BOTH, says=False),
        "work": Part(_if_any(tables.work), _BOTH, says=False),
        "nondifferentiable": Part(of_one(NONDIFFERENTIABLE, tables.nondifferentiable), (NONDIFFERENTIABLE,)),
        "nondifferentiable curves": Part(curves_of(NONDIFFERENTIABLE), (NONDIFFERENTIABLE,), says=False),
        "equal p": Part(of_one(EQUAL_P, equal_p.section), (EQUAL_P,)),
        "examples": Part(shown),
        "foot": Part(foot),
    },
)
