"""The paper's table of a campaign: success, perceptibility and truncated pixels by target and attack.

Every figure is over all cases of a cell, none of them left out for having failed to fool the network. A case counts if
the network's first answer was right; a job that failed counts as no success.
"""

from collections import Counter
from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict, Field

from services.statistics import wilson


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Case(_Record):
    """One job of a campaign after it has ended."""

    target: str
    attack: str = Field(description="name of the attack in the campaign")
    state: str = Field(description='"succeeded" (ran to its end), "failed" or "cancelled"')
    right: bool = Field(description="whether the truth is known and the network's first answer was right")
    outcome: str | None = Field(None, description="the job's outcome; null if it did not run to its end")
    epsilon_bound: bool = Field(False, description="some values of the stored perturbation are at their ε")
    success: bool = Field(False, description="outcome `fooled`, and verified")
    loop_success: bool = Field(
        False, description="right before, and fooled by the truncated image in the loop: the paper's count"
    )
    perceptibility: float | None = Field(
        None, description="p of the exact image, before it is rounded to 8 bits where that is known: the paper's p"
    )
    loop_perceptibility: float | None = Field(
        None, description="p of the truncated float image in the loop, at the stored step"
    )
    truncated: int | None = Field(None, description="pixels that were truncated in at least one step")
    queries: int | None = None
    seconds: float | None = Field(None, description="run time of the attack")
    run_seconds: float | None = Field(None, description="run time of the whole job")
    reused: bool = Field(False, description="an earlier result of the same request on the same backend was taken")


class Rate(_Record):
    """A share of cases, with Wilson's 95 % interval; null where there is no case."""

    count: int
    of: int
    rate: float | None
    low: float | None
    high: float | None

    @classmethod
    def of_cases(cls, count: int, of: int) -> "Rate":
        """The rate `count / of`."""
        if of == 0:
            return cls(count=0, of=0, rate=None, low=None, high=None)
        low, high = wilson(count, of)
        return cls(count=count, of=of, rate=count / of, low=low, high=high)


Corners = list[tuple[float, int]]
"""Corners of a step curve: the work done, and the number of successes by then."""


class Cell(_Record):
    """All jobs of one attack on one target."""

    target: str
    attack: str
    jobs: int = Field(description="jobs of the cell, ended or not")
    ended: int
    failed: int
    cancelled: int = Field(description="cancelled jobs, which count nowhere")
    reused: int
    outcomes: dict[str, int]
    held_within_epsilon: int = Field(
        0, description="of those that held: ε bound the search, and nothing was tried beyond"
    )
    success: Rate = Field(description="right before, fooled and verified")
    loop_success: Rate = Field(description="right before and fooled by the truncated image in the loop: the paper's")
    perceptibility: float | None = Field(
        description="mean p of the exact images of the successes, before they are rounded to 8 bits"
    )
    loop_perceptibility: float | None = Field(
        description="mean p of the truncated float images in the loop of those that the paper counts"
    )
    truncated: float | None = Field(description="mean number of pixels truncated in at least one step, over all cases")
    by_queries: Corners = Field(description="successes against queries, among `success.of` cases")
    by_seconds: Corners = Field(description="successes against seconds, among `success.of` cases")
    by_p: Corners = Field([], description="successes against p of the exact image, among `success.of` cases")
    most_queries: float | None = Field(None, description="most queries of any case: as far as `by_queries` is known")
    most_seconds: float | None = Field(None, description="most seconds of any case: as far as `by_seconds` is known")


class Table(_Record):
    """The table of a campaign: a row for each target, a column for each attack."""

    campaign: str
    targets: list[str]
    attacks: list[str]
    cells: list[Cell]

    def cell(self, target: str, attack: str) -> Cell | None:
        """The cell of a target and an attack; None if the campaign does not combine them."""
        return next((one for one in self.cells if (one.target, one.attack) == (target, attack)), None)


def table(campaign: str, planned: Sequence[tuple[str, str]], cases: Sequence[Case]) -> Table:
    """The table of the jobs that have ended, `cases`, among the `planned` ones, (target, attack) of every job.

    Rows and columns are in the order in which they first occur.
    """
    count = Counter(planned)
    return Table(
        campaign=campaign,
        targets=list(dict.fromkeys(target for target, _ in planned)),
        attacks=list(dict.fromkeys(attack for _, attack in planned)),
        cells=[
            _cell(target, attack, jobs, [case for case in cases if (case.target, case.attack) == (target, attack)])
            for (target, attack), jobs in count.items()
        ],
    )


def _cell(target: str, attack: str, jobs: int, own: Sequence[Case]) -> Cell:
    counted = [case for case in own if case.right and case.state != "cancelled"]
    won = [case for case in counted if case.success]
    in_loop = [case for case in counted if case.loop_success]
    return Cell(
        target=target,
        attack=attack,
        jobs=jobs,
        ended=len(own),
        failed=sum(case.state == "failed" for case in own),
        cancelled=sum(case.state == "cancelled" for case in own),
        reused=sum(case.reused for case in own),
        outcomes=dict(sorted(Counter(case.outcome for case in own if case.outcome is not None).items())),
        held_within_epsilon=sum(case.outcome == "held" and case.epsilon_bound for case in own),
        success=Rate.of_cases(len(won), len(counted)),
        loop_success=Rate.of_cases(len(in_loop), len(counted)),
        perceptibility=mean([case.perceptibility for case in won]),
        loop_perceptibility=mean([case.loop_perceptibility for case in in_loop]),
        truncated=mean([case.truncated for case in counted]),
        by_queries=corners([case.queries for case in won]),
        by_seconds=corners([case.seconds for case in won]),
        by_p=corners([case.perceptibility for case in won]),
        most_queries=max((case.queries for case in counted if case.queries is not None), default=None),
        most_seconds=max((case.seconds for case in counted if case.seconds is not None), default=None),
    )


def mean(values: Sequence[float | None]) -> float | None:
    """The mean of the values that are there; None if there is none."""
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None


def corners(work: Sequence[float | None]) -> Corners:
    """The corners of the number of successes against the work after which each came. Equal work makes one corner."""
    found: dict[float, int] = {}
    for number, at in enumerate(sorted(one for one in work if one is not None), 1):
        found[float(at)] = number
    return list(found.items())


def share_at(curve: Corners, of: int, work: float) -> float:
    """The share of `of` cases that succeeded with at most this much work: the height of the step curve there."""
    return max((count for at, count in curve if at <= work), default=0) / of
