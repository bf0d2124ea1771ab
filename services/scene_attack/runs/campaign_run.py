"""Runs a campaign in this process, without a service. A run that was interrupted goes on where it was.

`first_answers` is also what a worker does in a service's campaign: it asks a network about views.
"""

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from scene_attack import disk
from scene_attack.analysis.campaign_table import Case, Curves, mean_curves, table, time_left
from scene_attack.errors import Cancelled, InvalidRequest, JobFailure
from scene_attack.runs.campaign_plan import (
    CampaignResult,
    FirstAnswer,
    PlannedJob,
    View,
    case_of,
    curves_of,
    identity,
    meshes_in,
    plan,
    reusable,
    unfinished,
    views,
)
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.execute import execute, provenance
from scene_attack.runs.prepare import prepare_exactly, tasks_of_plan
from scene_attack.runs.result import RESULT, Result
from scene_attack.runs.spec import digest
from scene_attack.scenes.library import Library
from scene_attack.targets.scores import probability


def first_answers(
    views: Iterable[View], library: Library, cancelled: Callable[[], bool] = lambda: False
) -> Iterator[FirstAnswer]:
    """Yields the answer to the exact image of each view, rounded to 8 bits, or why it cannot be attacked. The same view
    of several grids is asked for once.

    Raises Cancelled once `cancelled()`, which is called before each view, is true.
    """
    asked: dict[str, FirstAnswer] = {}
    for view in views:
        if cancelled():
            raise Cancelled
        probe = digest(view.probe)
        if probe not in asked:
            asked[probe] = first_answer(view, library)
        yield asked[probe].model_copy(update={"view": view.number})


def first_answer(view: View, library: Library) -> FirstAnswer:
    """The answer to one view."""
    try:
        prepared = prepare_exactly(view.probe, library)
    except (InvalidRequest, JobFailure) as error:
        return FirstAnswer(view=view.number, refused=str(error))
    index = int(prepared.original.logits.argmax())
    label, confidence = prepared.target.labels[index], float(probability(prepared.original.logits, index))
    return FirstAnswer(
        view=view.number,
        label=label,
        confidence=confidence,
        truth=[prepared.target.labels[index] for index in prepared.settled.truth],
        tasks=tasks_of_plan(prepared),
        spec=prepared.spec,
        identity=identity(provenance(prepared), label, confidence),
    )


DONE = "done.json"
"""File beside the result of a job: its run time and the digest of the campaign that ran it. It is written last."""


@dataclass(frozen=True)
class CampaignProgress:
    """Progress of a campaign, in views in the phase "selecting" and in jobs in the phase "attacking"."""

    phase: str
    done: int
    total: int
    cases: Sequence[Case] = ()
    seconds_left: float | None = None
    now: str = ""


def run_campaign(
    campaign: CampaignSpec,
    out: Path,
    library: Library,
    *,
    progress: Callable[[CampaignProgress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> CampaignResult:
    """Runs all jobs of a campaign, one after another, and returns its table.

    Files in `out`: campaign.json, first_answers.jsonl, jobs.json (the digests of the requests of all jobs, in order),
    and a folder jobs/<digest> with the files of each job. A result that is there is taken if it is of the same request,
    assets, weights, backend and versions.
    Raises Cancelled as soon as `cancelled()` is true; what was done stays.
    """
    all_views = views(campaign)
    answers = _answers(campaign, all_views, out, library, progress, cancelled)
    chosen, planned = plan(campaign, all_views, answers, library.titles(meshes_in(all_views)))
    cells = [(job.target, job.attack) for job in planned]
    disk.write(out / "jobs.json", json.dumps([job.digest for job in planned], indent=1).encode())
    cases: list[Case] = []
    traced: list[tuple[str, str, Curves]] = []
    runner = _Runner(campaign, out / "jobs", library, cancelled)
    for job in planned:
        name = f"{job.target}, {job.attack}: {chosen[job.view].scene}"
        progress(CampaignProgress("attacking", len(cases), len(planned), cases, time_left(cells, cases), name))
        case, curves = runner.run(job)
        cases.append(case)
        if curves is not None and case.right:
            traced.append((job.target, job.attack, curves))
    progress(CampaignProgress("attacking", len(cases), len(planned), cases, 0.0))
    return CampaignResult(table=table(campaign.name, cells, cases), curves=mean_curves(traced), views=chosen)


def _answers(
    campaign: CampaignSpec,
    all_views: Sequence[View],
    out: Path,
    library: Library,
    progress: Callable[[CampaignProgress], None],
    cancelled: Callable[[], bool],
) -> dict[int, FirstAnswer]:
    out.mkdir(parents=True, exist_ok=True)
    words, begun, kept = campaign.model_dump_json(indent=1), out / "campaign.json", out / "first_answers.jsonl"
    answers: dict[int, FirstAnswer] = {}
    if kept.exists() and begun.exists() and begun.read_text("utf-8") == words:
        answers = _kept(kept, all_views, library)
    if not answers:
        kept.unlink(missing_ok=True)
        disk.write(begun, words.encode())
    with kept.open("a", encoding="utf-8") as file:
        for answer in first_answers([v for v in all_views if v.number not in answers], library, cancelled):
            file.write(answer.model_dump_json() + "\n")
            file.flush()
            answers[answer.view] = answer
            progress(CampaignProgress("selecting", len(answers), len(all_views)))
    return answers


def _kept(file: Path, all_views: Sequence[View], library: Library) -> dict[int, FirstAnswer]:
    """The first answers of an earlier run that still hold: one view of each target and renderer is asked for again."""
    answers: dict[int, FirstAnswer] = {}
    for line in file.read_text("utf-8").splitlines():
        try:
            answer = FirstAnswer.model_validate_json(line)
        except ValueError:  # the line that was being written when the run was killed
            break
        answers[answer.view] = answer
    groups: dict[tuple[str, str], list[FirstAnswer]] = {}
    for answer in answers.values():
        view = all_views[answer.view]
        groups.setdefault((view.probe.target.name, view.image_renderer), []).append(answer)
    for group in groups.values():
        sample = next((answer for answer in group if answer.refused is None), group[0])
        if first_answer(all_views[sample.view], library) != sample:
            for answer in group:
                del answers[answer.view]
    # written again, so that an incomplete line is gone
    disk.write(file, "".join(a.model_dump_json() + "\n" for a in answers.values()).encode())
    return answers


class _Runner:
    """Runs the jobs of a campaign into a folder, or takes their results from it."""

    def __init__(self, campaign: CampaignSpec, folder: Path, library: Library, cancelled: Callable[[], bool]) -> None:
        self._folder, self._library, self._cancelled = folder, library, cancelled
        self._reuse = campaign.reuse
        self._campaign = digest(campaign)

    def run(self, job: PlannedJob) -> tuple[Case, Curves | None]:
        place = self._folder / job.digest
        if (kept := _finished(place)) is not None:
            result, seconds, campaign = kept
            own = campaign == self._campaign
            if (own or self._reuse) and reusable(result, job):
                return case_of(job, result, run_seconds=seconds, reused=not own), curves_of(result)
        started = monotonic()
        try:
            result = self._execute(job, place)
        except (JobFailure, InvalidRequest) as error:
            (_part(place) / "failure.txt").write_text(f"{error}\n", "utf-8")
            return unfinished(job, "failed"), None
        seconds = monotonic() - started
        (_part(place) / DONE).write_text(json.dumps({"seconds": seconds, "campaign": self._campaign}) + "\n", "utf-8")
        shutil.rmtree(place, ignore_errors=True)
        _part(place).rename(place)
        return case_of(job, result, run_seconds=seconds), curves_of(result)

    def _execute(self, job: PlannedJob, place: Path) -> Result:
        part = _part(place)
        part.mkdir(parents=True, exist_ok=True)
        result = execute(job.spec, part, self._library, cancelled=self._cancelled, checkpoint=part / "checkpoint")
        for file in part.glob("checkpoint*"):
            file.unlink()
        return result


def _part(place: Path) -> Path:
    """The folder of a job that has not ended, with its checkpoint."""
    return place.with_name(f"{place.name}.part")


def _finished(place: Path) -> tuple[Result, float, str] | None:
    """The result of a job, the seconds that it took, and the digest of its campaign."""
    try:
        done = json.loads((place / DONE).read_text("utf-8"))
        result = Result.model_validate_json((place / RESULT).read_bytes())
        return result, float(done["seconds"]), str(done["campaign"])
    except (OSError, ValueError, KeyError):
        return None
