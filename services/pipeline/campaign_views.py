"""Finds a network's first answers to the views of a campaign: a rendering and a query for each."""

from collections.abc import Callable, Iterable, Iterator

from services.errors import Cancelled, InvalidRequest, JobFailure
from services.pipeline.campaign_case import identity
from services.pipeline.campaign_expand import View
from services.pipeline.campaign_select import FirstAnswer
from services.pipeline.execute import provenance
from services.pipeline.prepare import prepare_exactly
from services.scenes.library import Library
from services.targets.scores import probability


def first_answers(
    views: Iterable[View], library: Library, cancelled: Callable[[], bool] = lambda: False
) -> Iterator[FirstAnswer]:
    """Yields the answer to the exact image of each view, rounded to 8 bits, or why it cannot be attacked.

    Raises Cancelled once `cancelled()`, which is called before each view, is true.
    """
    for view in views:
        if cancelled():
            raise Cancelled
        yield first_answer(view, library)


def first_answer(view: View, library: Library) -> FirstAnswer:
    """The answer to one view."""
    try:
        prepared = prepare_exactly(view.probe, library)
    except (InvalidRequest, JobFailure) as error:
        return FirstAnswer(view=view.number, refused=str(error))
    index = int(prepared.logits.argmax())
    label, confidence = prepared.target.labels[index], float(probability(prepared.logits, index))
    return FirstAnswer(
        view=view.number,
        label=label,
        confidence=confidence,
        truth=[prepared.target.labels[index] for index in prepared.truth],
        programs=[question.program.written() for question in prepared.questions],
        spec=prepared.spec,
        identity=identity(provenance(prepared), label, confidence),
    )
