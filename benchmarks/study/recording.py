"""Makes the record of a campaign out of the folder that `scene-attack campaign run` wrote."""

import json
import platform
from pathlib import Path
from typing import Any

from benchmarks.study.asked import asked
from benchmarks.study.record import Job, Record, Views
from services.analysis.campaign_table import CURVES, MeanCurves
from services.pipeline.campaign_plan import (
    CampaignResult,
    FirstAnswer,
    PlannedJob,
    View,
    case_of,
    plan,
    views,
)
from services.pipeline.campaign_spec import CampaignSpec
from services.pipeline.result import Result
from services.pipeline.spec import JobSpec

DIGITS = 12
"""Hexadecimal digits kept of a SHA-256: enough to find a request or a scene again."""
CURVE_DIGITS = 4
"""Significant digits of the mean curves."""


def of_folder(folder: Path) -> Record:
    """The record of the folder that `scene-attack campaign run` wrote.

    Raises ValueError if a job has neither a result nor a failure: the campaign has not been run to its end.
    """
    campaign = CampaignSpec.model_validate_json((folder / "campaign.json").read_bytes())
    whole = CampaignResult.model_validate_json((folder / "table.json").read_bytes())
    found = views(campaign)
    lines = (folder / "first_answers.jsonl").read_text("utf-8").splitlines()
    answers = {one.view: one for one in map(FirstAnswer.model_validate_json, lines)}
    every, planned = plan(campaign, found, answers)
    chosen = [view.number for view in every if view.chosen]
    requests: list[str] = json.loads((folder / "jobs.json").read_text("utf-8"))
    results = [_result(folder, request) for request in requests]
    there = [result for result in results if result is not None]
    return Record(
        command=f"scene-attack campaign run examples/{campaign.name}.json --out out/{campaign.name}",
        campaign=campaign.model_dump(mode="json"),
        machine=platform.platform(),
        versions=there[0].provenance.versions,
        backends=tuple(sorted({result.provenance.backend for result in there})),
        weights={str(r.spec["target"]["name"]): r.provenance.weights_sha256 for r in there},  # type: ignore[index]
        credits=tuple(sorted({credit for result in there for credit in result.provenance.credits})),
        views=_views(found, answers, chosen),
        jobs=tuple(
            _job(job, request, result, answers[job.view]).model_copy(
                update={"questions": asked(found[job.view].asked, result, folder / "jobs" / request)}
            )
            for job, request, result in zip(planned, requests, results, strict=True)
        ),
        curves=tuple(_rounded(curves) for curves in whole.curves),
    )


def _result(folder: Path, request: str) -> Result | None:
    """The result of the job with this digest of its request; None if it failed."""
    path = folder / "jobs" / request / "result.json"
    if path.exists():
        return Result.model_validate_json(path.read_bytes())
    if not (folder / "jobs" / f"{request}.part" / "failure.txt").exists():
        raise ValueError(f"{folder}: job {request} has not ended; run the campaign to its end")
    return None


def _job(job: PlannedJob, request: str, result: Result | None, answer: FirstAnswer) -> Job:
    assert answer.label is not None
    assert answer.confidence is not None
    about: dict[str, Any] = {
        "target": job.target,
        "attack": job.attack,
        "mesh": _subject(job.spec),
        "azimuth": round(job.spec.scene.camera.azimuth, 4),
        "seed": job.spec.seed,
        "truth": tuple(answer.truth),
        "before": answer.label,
        "before_confidence": _short(answer.confidence),
        "request": request[:DIGITS],
    }
    if result is None:
        return Job(**about, state="failed")
    case = case_of(job, result)
    return Job(
        **about,
        after=result.attacked.label,
        after_confidence=_short(result.attacked.confidence),
        outcome=result.outcome,
        fooled=result.fooled,
        verified=result.verified,
        p=_short(case.perceptibility),
        p_saved=_short(result.perceptibility),
        p_loop=_short(case.loop_perceptibility),
        step=result.step,
        steps=result.steps,
        queries=result.queries,
        seconds=_short(result.seconds),
        truncated=result.truncated,
        lowered=_lowered(result),
        **_covered(result),
        scene=result.provenance.scene_sha256[:DIGITS],
    )


def _subject(spec: JobSpec) -> str:
    """The name of a scene after CLEVR, else the meshes of a scene."""
    if spec.record is not None:
        return spec.record.image_filename.removesuffix(".png")
    return ", ".join(thing.mesh for thing in spec.scene.objects)


def _lowered(result: Result) -> bool | None:
    found = [row.objective for row in result.trace if row.objective is not None]
    return min(found) < found[0] if found else None


def _covered(result: Result) -> dict[str, Any]:
    """The pixels that show an object and all pixels, if the plan says so."""
    found = next((item for item in result.plan.items if item.what == "pixels"), None)
    return {} if found is None else {"covered": found.kept, "pixels": found.of}


def _views(found: list[View], answers: dict[int, FirstAnswer], chosen: list[int]) -> tuple[Views, ...]:
    groups: dict[tuple[str, str, tuple[int, int]], list[int]] = {}
    for view in found:
        key = (view.probe.target.name, view.image_renderer, view.probe.scene.camera.size)
        groups.setdefault(key, []).append(view.number)
    rows = []
    for (target, renderer, size), numbers in groups.items():
        own = [answers[number] for number in numbers if number in answers]
        taken = [number for number in numbers if number in chosen]
        sure = [answers[number].confidence or 0.0 for number in taken]
        rows.append(
            Views(
                target=target,
                renderer=renderer,
                size=size,
                asked=len(numbers),
                right=sum(answer.right for answer in own),
                chosen=len(taken),
                meshes=len({_subject(found[number].probe) for number in taken}),
                least_confidence=_short(min(sure, default=None)),
            )
        )
    return tuple(rows)


def _rounded(curves: MeanCurves) -> MeanCurves:
    values = {name: [_short(value, CURVE_DIGITS) for value in getattr(curves, name)] for name in CURVES}
    return curves.model_copy(update=values)


def _short(value: float | None, digits: int = 5) -> Any:
    return None if value is None else float(f"{value:.{digits}g}")
