"""Tables of what was asked: success by family and by kind of answer, answers that left their kind, and the modules that
were fooled first.

Jobs with several questions, which are attacked together, are left out: their success is of all of them at once.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import get_args

from benchmarks.study.fooled_first import GROUPS, group
from benchmarks.study.record import Asked, Job, Record
from benchmarks.study.tables import NONE, OF, markdown
from services.questions.answers import KINDS, kind_of
from services.questions.templates.families import Kind

LONGEST = (6, 12)
"""Lengths of programs, in functions, that end a row."""
SHOWN = 6
"""Answers of another kind that are listed."""


def alone(record: Record) -> list[Job]:
    """Returns the jobs with one question, which the network had right."""
    return [job for job in record.jobs if job.right and len(job.questions) == 1]


def attacks(record: Record) -> list[str]:
    """Returns the attacks of these jobs, in the order of the campaign."""
    return list(dict.fromkeys(job.attack for job in alone(record)))


def by_question(record: Record) -> str:
    """Success by kind of family, by kind of the answer, and by length of the program: a row for each that was asked."""
    rows = []
    for heading, of, values in (
        ("family", lambda one: one.family, get_args(Kind)),
        ("answer", lambda one: one.kind, tuple(KINDS)),
        ("functions", lambda one: _length(len(one.functions)), tuple(map(_length, (*LONGEST, LONGEST[-1] + 1)))),
    ):
        block = [_row(record, value, of) for value in values]
        block = [cells for cells in block if any(cell != NONE for cell in cells[1:])]
        rows += [[f"**{heading}**" if number == 0 else "", *cells] for number, cells in enumerate(block)]
    return markdown(("", "", *attacks(record)), rows, texts=2)


def left_kind(record: Record) -> str:
    """How often a wrong answer after an attack is of another kind than is asked for, and some of these answers."""
    rows, said = [], []
    for attack in attacks(record):
        fooled = [job.questions[0] for job in alone(record) if job.attack == attack and job.success]
        left = [one for one in fooled if one.of_kind is False]
        to = Counter(kind_of(one.after) for one in left if one.after is not None)
        rows.append(
            [attack, str(len(fooled)), str(len(left)), ", ".join(f"{kind} {n}" for kind, n in to.most_common()) or NONE]
        )
        said += [f"- {attack}: “{one.text}” {one.right}, then **{one.after}**" for one in left]
    table = markdown(("attack", "fooled", "of another kind", "which"), rows)
    return "\n\n".join([table, "\n".join(said[:SHOWN])]) if said else table


def fooled_first(record: Record) -> str:
    """Of the fooled questions whose program has a group of functions, those in which one of it was fooled first."""
    rows = []
    columns = {
        attack: [job.questions[0] for job in alone(record) if job.attack == attack and job.success]
        for attack in attacks(record)
    }
    for name in dict.fromkeys(GROUPS.values()):
        cells = [_first(name, fooled) for fooled in columns.values()]
        if any(cell != NONE for cell in cells):
            rows.append([name, *cells])
    return markdown(("module", *columns), rows)


def _first(name: str, fooled: Sequence[Asked]) -> str:
    having = [one for one in fooled if name in map(group, one.functions)]
    first = [one for one in having if one.first is not None and group(one.functions[one.first]) == name]
    return f"{len(first)}{OF}{len(having)}" if having else NONE


def _row(record: Record, value: str, of: Callable[[Asked], str]) -> list[str]:
    cells = []
    for attack in attacks(record):
        own = [job for job in alone(record) if job.attack == attack and of(job.questions[0]) == value]
        cells.append(f"{sum(job.success for job in own)}{OF}{len(own)}" if own else NONE)
    return [value.replace("_", " "), *cells]


def _length(functions: int) -> str:
    low = 1
    for high in LONGEST:
        if functions <= high:
            return f"{low}–{high}"
        low = high + 1
    return f"{low} and more"
