"""The page of the paper's study of visual question answering (section 4.2), on scenes after CLEVR."""

from benchmarks.study import curves, question_tables, reasons, tables
from benchmarks.study.page import Page, Part, curves_of, foot, of_one, shown
from benchmarks.study.record import Record

DIFFERENTIABLE, NONDIFFERENTIABLE = "vqa-differentiable", "vqa-nondifferentiable"
_FIRST, _SECOND = (DIFFERENTIABLE,), (NONDIFFERENTIABLE,)


def _differentiable(record: Record) -> str:
    return tables.differentiable([record], tables.VQA)


def _orders(record: Record) -> str:
    return "\n".join(f"- {tables.orders(record, target)}" for target in record.table().targets)


def _nondifferentiable(record: Record) -> str:
    return tables.nondifferentiable(record, tables.VQA)


VQA = Page(
    name="vqa.md",
    curves={DIFFERENTIABLE: curves.questions, NONDIFFERENTIABLE: curves.nondifferentiable},
    with_examples=(DIFFERENTIABLE, NONDIFFERENTIABLE),
    parts={
        "views": Part(lambda study: tables.views(list(study.records.values()), of="scenes")),
        "differentiable": Part(of_one(DIFFERENTIABLE, _differentiable), _FIRST),
        "orders": Part(of_one(DIFFERENTIABLE, _orders), _FIRST, says=False),
        "differentiable curves": Part(curves_of(DIFFERENTIABLE), _FIRST, says=False),
        "confidence": Part(of_one(DIFFERENTIABLE, lambda record: reasons.by_confidence([record])), _FIRST, says=False),
        "nondifferentiable": Part(of_one(NONDIFFERENTIABLE, _nondifferentiable), _SECOND),
        "nondifferentiable curves": Part(curves_of(NONDIFFERENTIABLE), _SECOND, says=False),
        "questions": Part(of_one(DIFFERENTIABLE, question_tables.by_question), _FIRST),
        "questions nondifferentiable": Part(of_one(NONDIFFERENTIABLE, question_tables.by_question), _SECOND),
        "kinds": Part(of_one(DIFFERENTIABLE, question_tables.left_kind), _FIRST),
        "kinds nondifferentiable": Part(of_one(NONDIFFERENTIABLE, question_tables.left_kind), _SECOND, says=False),
        "modules": Part(of_one(DIFFERENTIABLE, question_tables.fooled_first), _FIRST),
        "modules nondifferentiable": Part(of_one(NONDIFFERENTIABLE, question_tables.fooled_first), _SECOND, says=False),
        "examples": Part(shown),
        "foot": Part(foot),
    },
)
