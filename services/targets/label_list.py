"""Lists the labels of a target without loading it, and checks them. It needs no torch, unless an extension does."""

from collections import Counter

from services.errors import InvalidRequest, JobFailure, out_of_memory, printable, summary
from services.targets.info import LONGEST_LABEL, RegisteredTarget

_SHOWN = 400
"""Characters of a target's own error that a message shows; torch lists every weight that is missing."""


def labels(name: str, known: RegisteredTarget) -> tuple[str, ...]:
    """Returns the labels of a target without loading it.

    Raises InvalidRequest("target.name") if they cannot be listed, are no text that can be printed, or are not unique.
    """
    try:
        found = tuple(known.labels())
    except (Exception, SystemExit) as error:
        raise refused(name, f"cannot list its labels: {in_words(name, error)}") from error
    for label in found:
        if not isinstance(label, str) or not label or printable(label) != label:
            raise refused(name, f"has the label {label!r:.80}, which is no text to be shown")
        if len(label) > LONGEST_LABEL:
            raise refused(name, f"has the label {label!r:.80}… of {len(label):,} characters; {LONGEST_LABEL} are most")
    for label, times in Counter(found).items():
        if times > 1:
            raise refused(name, f"has the label {label!r} more than once; labels are unique")
    return found


def in_words(name: str, error: BaseException) -> str:
    """The error in words. Raises JobFailure("out-of-memory") if memory has run out: other jobs may have taken it."""
    if isinstance(error, InvalidRequest):
        raise error
    if out_of_memory(error):
        raise JobFailure("out-of-memory", f"target {name!r} needs more memory than is left") from error
    words = summary(error)
    return words if len(words) <= _SHOWN else f"{words[:_SHOWN]}…"


def refused(name: str, why: str) -> InvalidRequest:
    """The error of a target that cannot be used."""
    return InvalidRequest("target.name", f"target {name!r} {why}")
