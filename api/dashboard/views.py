"""The data that the pages show of a job, taken from the record.

The trace of a job, with and without a result: what its events make of it.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from api.dashboard.charts import Chart, Upset, chart, upset
from api.dashboard.questions import Question, SceneObject, objects, questions
from services.attacks.outcome import judge
from services.jobs.job_list import ListedJob
from services.jobs.models import Artifact, Event, Job, State
from services.jobs.record import Record
from services.pipeline.names import group_words, question_names
from services.pipeline.result import CHECKPOINT


def all_events(record: Record, job_id: str) -> Iterator[Event]:
    """Every event of a job, in order."""
    after = 0
    while page := record.jobs.events(job_id, after):
        yield from page
        after = page[-1].number


def trace_of(job: Job, events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace of the result or, if there is none yet, that of the events, which are read for this alone."""
    if job.result:
        found: list[dict[str, Any]] = job.result["trace"]
        return found
    return trace_of_events(events)


def trace_of_events(events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace so far. A resumed attempt repeats some steps; its rows replace the earlier rows of these steps."""
    rows: list[dict[str, Any]] = []
    for event in events:
        if event.kind != "progress":
            continue
        for row in event.data["rows"]:
            while rows and rows[-1]["step"] >= row["step"]:
                rows.pop()
            rows.append(row)
    return rows


IMAGES = ("original.png", "attacked.png", "perturbation.png")
SEARCHED = ("coordinates", "coordinates that reach the answer")
"""What a plan calls the coordinates of a group that the attack on a question searches."""
ROWS = 100
"""Rows of a trace that a page's table has at most."""
LEAST = 0.01
"""Least height of the axes of p (thousandths) and distance, so that rounding of an unchanged image is not magnified."""


@dataclass(frozen=True)
class Line:
    """The data of a job in the list."""

    id: str
    state: State
    name: str
    """The question, or the scene of a job without one."""
    scene: str
    attack: str
    target: str
    created_at: datetime
    phase: str | None
    step: int | None
    steps: int | None
    outcome: dict[str, Any] | None
    failure_kind: str | None
    waiting: str | None
    """Why no live worker takes the queued job; None if one of them can run it."""


@dataclass(frozen=True)
class Page:
    """The data of a job's page."""

    line: Line
    spec: dict[str, Any]
    times: dict[str, datetime]
    attempt: int
    failure_detail: str | None
    errors: list[dict[str, Any]]
    """The invalid fields of a rejected job."""
    warnings: list[Any]
    result: dict[str, Any] | None
    subsets: list[dict[str, Any]]
    attribution: dict[str, Any] | None
    """The attribution to the groups, which it calls as pages do; None without a result and for a single group."""
    upset: Upset | None
    """The plot of the subsets; None without a result or for a single group."""
    last: dict[str, Any] | None
    by_step: list[Chart]
    by_queries: list[Chart]
    by_seconds: list[Chart]
    rows: list[dict[str, Any]]
    """Rows of the trace, evenly chosen, at most `ROWS` and the last."""
    artifacts: list[Artifact]
    attention_files: list[Artifact]
    """The images of attention, which are many."""
    best: dict[str, Any] | None
    """The best so far of a job that ended before its time (services.pipeline.best_so_far)."""
    continuable: bool
    """Whether another job can go on from its checkpoint."""
    went_on: bool
    """Whether it began with the checkpoint of the job that it repeats."""
    cancellable: bool
    analysed: bool
    """Whether the request asked for analyses, and they are made."""
    questions: list[Question]
    objects: list[SceneObject]
    effect_groups: list[str]
    """The groups whose effect on single objects was measured."""
    limits: list[dict[str, Any]]
    """The plan's lines about coordinates that the search leaves out, of jobs with questions."""
    image_size: tuple[int, int]
    """Height and width of the images."""


def line(job: Job | ListedJob) -> Line:
    """The data that the list shows of a job."""
    return Line(
        id=job.id,
        state=job.state,
        name=job.name or "",
        scene=job.scene or "",
        attack=job.attack or "",
        target=job.target or "",
        created_at=job.created_at,
        phase=job.phase,
        step=job.step,
        steps=job.steps,
        outcome=job.outcome,
        failure_kind=job.failure_kind,
        waiting=job.waiting if job.state is State.QUEUED else None,
    )


def page(job: Job, events: Iterable[Event], artifacts: Sequence[Artifact], best: dict[str, Any] | None = None) -> Page:
    """The data that a job's page shows. The trace is the result's or, if there is none yet, that of the events; `best`
    is what a job had found that ended before its time.
    """
    trace = trace_of(job, events)
    height, width = job.spec["scene"]["camera"]["size"]
    asked = questions(job.result, job.spec, question_names(job.spec))
    shown = {name for one in asked for of in one.result.attention for name in (of.before, of.after)}
    things = objects(job.result, job.spec)
    rows = subsets(job.result)
    names = {group: group_words(job.spec, group) for group in (rows[-1]["groups"] if rows else ())}
    shares = None if job.result is None else job.result["attribution"]
    has_checkpoint = any(one.name == CHECKPOINT for one in artifacts)
    # It has a checkpoint from its beginning. One that only repeats has none with a result, and else its own later.
    went_on = (
        has_checkpoint and job.retry_of is not None and (job.result is not None or not trace or trace[0]["step"] > 0)
    )
    return Page(
        line=line(job),
        spec=job.spec,
        times=job.times,
        attempt=job.attempt,
        failure_detail=job.failure_detail,
        errors=job.errors or [],
        warnings=job.warnings,
        result=job.result,
        subsets=rows,
        attribution=shares | {"parts": [names[part] for part in shares["parts"]]}
        if shares and len(names) > 1
        else None,
        upset=shares and upset(rows, shares, names, [one.name for one in artifacts]),
        last=trace[-1] if trace else None,
        by_step=charts(trace, job.spec, "step"),
        by_queries=charts(trace, job.spec, "queries"),
        by_seconds=charts(trace, job.spec, "seconds"),
        rows=evenly(trace),
        artifacts=[one for one in artifacts if one.name not in shown],
        attention_files=[one for one in artifacts if one.name in shown],
        best=best,
        continuable=has_checkpoint and job.state in (State.CANCELLED, State.FAILED),
        went_on=went_on,
        cancellable=not job.state.terminal and job.state != State.CANCELLING,
        analysed=job.result is not None and any(job.result["analyses"].values()),
        questions=asked,
        objects=things,
        effect_groups=[one for one in job.spec["attack"]["groups"] if any(one in thing.effects for thing in things)],
        limits=limits(job.result, job.spec) if asked else [],
        image_size=(height, width),
    )


def limits(result: dict[str, Any] | None, spec: dict[str, Any]) -> list[dict[str, Any]]:
    """The plan's lines about the coordinates of the attacked groups."""
    items = [] if result is None else result["plan"]["items"]
    return [item for item in items if item["part"] in spec["attack"]["groups"] and item["what"] in SEARCHED]


def subsets(result: dict[str, Any] | None) -> list[dict[str, Any]]:
    """The table of subsets, each with its outcome as if its groups were all of the perturbation."""
    if result is None:
        return []
    truth, first = result["truth"], result["original"]["label"]
    return [one | {"outcome": judge(truth, first, one["label"], one["fooled"])} for one in result["subsets"]]


def evenly(trace: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a trace at equal distances, and the last."""
    every = max(1, -(-len(trace) // ROWS))
    return [row for k, row in enumerate(trace) if k % every == 0 or k == len(trace) - 1]


def charts(trace: Sequence[dict[str, Any]], spec: dict[str, Any], against: str) -> list[Chart]:
    """The charts of a trace against "step", "queries" or "seconds"; an empty list for an empty trace."""
    if not trace:
        return []
    goal = spec["goal"]
    if goal.get("reach") is not None:
        loss, other = f"1 − probability of “{goal['reach']}”", "below 0: the network says the wanted label"
    else:
        loss, other = f"Probability of {_labels(goal.get('leave'))}", "below 0: another answer"

    def curve(key: str, scale: float = 1.0) -> list[tuple[float, float]]:
        return [(row[against], row[key] * scale) for row in trace]

    whole = against != "seconds"
    return [
        chart(loss, against, curve("loss"), include=(0, 1), whole=whole),
        chart("Log-probability advantage", against, curve("advantage"), threshold=0, note=other, whole=whole),
        chart(
            "Perceptibility p, in thousandths", against, curve("perceptibility", 1000), include=(0, LEAST), whole=whole
        ),
        chart("Distance ‖ΔY‖₂", against, curve("distance"), include=(0, LEAST), whole=whole),
    ]


def _labels(leave: str | int | list[str | int] | None) -> str:
    """The labels to leave, in words; the request of a job that has not begun may not name them."""
    if leave is None:
        return "the label to leave"
    return " or ".join(f"“{label}”" for label in (leave if isinstance(leave, list) else [leave]))
