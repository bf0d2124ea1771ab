"""The data that the pages show of a job, taken from the record.

They are its trace, with and without a result, and what its task adds, drawn by the task's own template.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from typing import Any, Self

from scene_attack.analysis.verdict import judge
from scene_attack.runs.result import CHECKPOINT
from scene_attack.runs.spec import group_words
from scene_attack.runs.task_parts import ResultPart, parts_of
from scene_attack_api.dashboard.charts import Chart, chart, upset
from scene_attack_service.jobs.models import Artifact, Event, Job, State
from scene_attack_service.jobs.record import Record


def all_events(record: Record, job_id: str) -> Iterator[Event]:
    """Every event of a job, in order."""
    after = 0
    while page := record.jobs.events(job_id, after):
        yield from page
        after = page[-1].number


def trace_of(job: Job, events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace of the result or, if there is none yet, that of the events, which are read for this alone."""
    if job.result:
        trace: list[dict[str, Any]] = job.result["trace"]
        return trace
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


@dataclass(frozen=True)
class Drawn:
    """What a task adds to a result, as its template draws it. several: whether it attacks several answers together."""

    template: str
    shown: object
    several: bool

    @classmethod
    def of(cls, name: str, part: ResultPart, spec: Mapping[str, Any], result: Mapping[str, Any]) -> Self:
        """The part of a task, by its name. Without a template of its own it has the one that draws nothing."""
        template = "task.html" if part.template is None else f"{OF_TASKS}/{name}"
        return cls(template, part.shown(spec, result), bool(part.answers))


OF_TASKS = "tasks"
"""Beginning of the names of templates that tasks bring."""
IMAGES = ("original.png", "attacked.png", "perturbation.png")
ROWS = 100
"""Rows of a trace that a page's table has at most."""
LEAST = 0.01
"""Least height of the axes of p (thousandths) and distance, so that rounding of an unchanged image is not magnified."""


def page(
    job: Job, events: Iterable[Event], artifacts: Sequence[Artifact], best: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Data that a job's page shows beside the job. The trace is the result's or, if there is none yet, that of the
    events; `best` is the best result of a job that ended before its time (scene_attack.runs.execute).
    """
    trace = trace_of(job, events)
    spec, result = job.spec, job.result
    parts = parts_of((result or {}).get("tasks"))
    patterns = [pattern for part in parts.values() for pattern in part.contents]
    of_tasks = [artifact for artifact in artifacts if any(fnmatch(artifact.name, pattern) for pattern in patterns)]
    rows = subsets(result)
    names = {group: group_words(spec, group) for group in (rows[-1]["groups"] if rows else ())}
    shares = None if result is None else result["attribution"]
    has_checkpoint = any(artifact.name == CHECKPOINT for artifact in artifacts)
    return {
        "subsets": rows,
        # Both are None without a result and for a single group; pages have other names of groups.
        "attribution": shares | {"parts": [names[part] for part in shares["parts"]]}
        if shares and len(names) > 1
        else None,
        "upset": shares and upset(rows, shares, names, [artifact.name for artifact in artifacts]),
        "last": trace[-1] if trace else None,
        "charts": {against: charts(trace, spec, against) for against in ("step", "queries", "seconds")},
        "rows": evenly(trace),
        "artifacts": [artifact for artifact in artifacts if artifact not in of_tasks],
        "task_files": of_tasks,  # which are many
        "best": best,
        "continuable": has_checkpoint and job.state in (State.CANCELLED, State.FAILED),
        # Whether it began with the checkpoint of the job that it repeats, which it then has from its beginning. One
        # that only repeats has none with a result, and else its own later.
        "went_on": has_checkpoint
        and job.retry_of is not None
        and (result is not None or not trace or trace[0]["step"] > 0),
        "tasks": [] if result is None else [Drawn.of(name, part, spec, result) for name, part in parts.items()],
        "image_size": tuple(spec["scene"]["camera"]["size"]),
    }


def subsets(result: dict[str, Any] | None) -> list[dict[str, Any]]:
    """The table of subsets, each with its outcome as if its groups were all of the perturbation."""
    if result is None:
        return []
    truth, first = result["verdict"]["truth"], result["original"]["label"]
    return [
        subset | {"outcome": judge(truth, first, subset["label"], subset["fooled"])} for subset in result["subsets"]
    ]


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
