"""Makes the record of a campaign out of the folder that `scene-attack campaign run` wrote.

Of a question it says which module of the network the attack fooled first, by what the modules attend to. A module's
result is read as objects. An object is in a set if the mask at the cell of its centre is at least HALF; it has left or
joined the set if the mask passed HALF and changed by more than LEAST, so that a mask that hovers there is no change.
The module `unique` picks the object with the largest mask. The first module whose objects changed is the one that was
fooled first: those before it see what they saw. Counts, queries and comparisons attend to nothing. If no set and no
object changed, the end of the program was fooled: its last function, with the counts or queries that it compares.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safetensors.torch import load_file

from benchmarks.study.record import Around, Asked, Job, Record, Views
from scene_attack.analysis.campaign_table import CURVES, MeanCurves
from scene_attack.analysis.records import HeldOver
from scene_attack.runs.campaign_plan import CampaignResult, FirstAnswer, PlannedJob, View, case_of, plan, views
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.described import can_carry, described
from scene_attack.runs.result import PERTURBATION, Result
from scene_attack.runs.spec import JobSpec
from scene_attack.runs.task_parts import Member
from scene_attack_questions.clevr.description import record_after
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import kind_asked
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.grid import QuestionMember
from scene_attack_questions.program import Program
from scene_attack_questions.records import ATTENTION, QuestionResult
from scene_attack_questions.source import Clevr
from training.iep.examples import ObjectTruth

if TYPE_CHECKING:
    from torch import Tensor

DIGITS = 12
"""Hexadecimal digits kept of a SHA-256: enough to find a request or a scene again."""
CURVE_DIGITS = 4
"""Significant digits of the mean curves."""
CONFIDENCE_DIGITS = 5
"""Significant digits of confidences."""
HALF = 0.5
"""Between 1, for which masks are trained at the cell of a member's centre, and 0 at other cells."""
LEAST = 0.25
"""Half of the way from HALF to either end."""


def of_folder(folder: Path) -> Record:
    """The record of the folder that `scene-attack campaign run` wrote.

    Raises ValueError if a job has neither a result nor a failure: the campaign has not been run to its end.
    """
    campaign = CampaignSpec.model_validate_json((folder / "campaign.json").read_bytes())
    whole = CampaignResult.model_validate_json((folder / "table.json").read_bytes())
    all_views = views(campaign)
    lines = (folder / "first_answers.jsonl").read_text("utf-8").splitlines()
    answers = {answer.view: answer for answer in map(FirstAnswer.model_validate_json, lines)}
    every, planned = plan(campaign, all_views, answers)
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
        views=_views(all_views, answers, chosen),
        jobs=tuple(
            _job(job, request, result, answers[job.view]).model_copy(
                update={"questions": asked(all_views[job.view].member, result, folder / "jobs" / request)}
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
        fooled=result.verdict.fooled,
        verified=result.verified,
        p=_short(case.perceptibility),
        p_saved=_short(result.change.perceptibility),
        p_loop=_short(case.loop_perceptibility),
        step=result.change.step,
        steps=result.cost.steps,
        queries=result.cost.queries,
        seconds=_short(result.cost.seconds),
        truncated=result.cost.truncated,
        lowered=_lowered(result),
        **_covered(result),
        around=_held_over(result.expectation),
        survival=_held_over(result.analyses.survival),
        second_opinion=dict(case.second_opinion),
        scene=result.provenance.scene_sha256[:DIGITS],
    )


def _subject(spec: JobSpec) -> str:
    """The name of a scene after CLEVR, else the meshes of a scene."""
    if spec.scene.source is not None:
        return _record(spec).image_filename.removesuffix(".png")
    return ", ".join(thing.mesh for thing in spec.scene.objects)


def _lowered(result: Result) -> bool | None:
    objectives = [row.objective for row in result.trace if row.objective is not None]
    return min(objectives) < objectives[0] if objectives else None


def _covered(result: Result) -> dict[str, Any]:
    """The pixels that show an object and all pixels, if the plan says so."""
    pixels = next((item for item in result.plan.items if item.what == "pixels"), None)
    return {} if pixels is None else {"covered": pixels.kept, "pixels": pixels.of}


def _held_over(held: HeldOver | None) -> Around | None:
    return None if held is None else Around(views=held.variations, right=held.right, fooled=held.fooled)


def _views(all_views: list[View], answers: dict[int, FirstAnswer], chosen: list[int]) -> tuple[Views, ...]:
    groups: dict[tuple[str, str, tuple[int, int]], list[int]] = {}
    for view in all_views:
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
                meshes=len({_subject(all_views[number].probe) for number in taken}),
                least_confidence=_short(min(sure, default=None)),
            )
        )
    return tuple(rows)


def _rounded(curves: MeanCurves) -> MeanCurves:
    values = {name: [_short(value, CURVE_DIGITS) for value in getattr(curves, name)] for name in CURVES}
    return curves.model_copy(update=values)


def _short(value: float | None, digits: int = 5) -> Any:
    return None if value is None else float(f"{value:.{digits}g}")


def asked(member: Member, result: Result | None, folder: Path) -> tuple[Asked, ...]:
    """Returns the records of a job's questions. `folder` has its files; `result` is None if it failed.

    Raises ValueError if the network had another program than that of a question.
    """
    rows = []
    for number, question in enumerate(member.questions if isinstance(member, QuestionMember) else ()):
        program, family, right = question.program, question.question_family_index, question.answer
        if program is None or family is None or right is None:
            raise ValueError(f"{question.question!r} has no program, family or answer")
        about = Asked(
            text=question.question,
            family=FAMILIES[family].kind,
            kind=kind_asked(program),
            functions=tuple(node.function for node in program.nodes),
            right=right,
        )
        if result is not None:
            about = _answered(about, program, result.tasks["questions"].questions[number])
            if about.fooled:
                about = about.model_copy(update={"first": _first(number, program, result, folder)})
        rows.append(about)
    return tuple(rows)


def _answered(about: Asked, program: Program, came: QuestionResult) -> Asked:
    if came.program != program.written() or came.right != about.right:
        raise ValueError(f"{about.text!r}: the result is of another program or truth")
    return about.model_copy(
        update={
            "right_after": came.right_after,
            "before": came.before.label,
            "before_confidence": float(f"{came.before.confidence:.{CONFIDENCE_DIGITS}g}"),
            "after": came.after.label,
            "after_confidence": float(f"{came.after.confidence:.{CONFIDENCE_DIGITS}g}"),
            "of_kind": came.after_of_kind,
            "outcome": came.outcome,
        }
    )


def _first(number: int, program: Program, result: Result, folder: Path) -> int:
    spec = JobSpec.model_validate(result.spec)
    record = _record(spec)
    masks = load_file(folder / ATTENTION)
    nodes = [int(node) for question, node, when in (key.split(".") for key in masks) if question == str(number)]
    before, after = ({node: masks[f"{number}.{node}.{when}"] for node in nodes} for when in ("before", "after"))
    return fooled_first(program, before, after, _cells(record), _cells(_attacked(spec, folder)))


def _cells(record: SceneRecord) -> list[int]:
    return [ObjectTruth.of(solid).cell for solid in record.objects]


def _record(spec: JobSpec) -> SceneRecord:
    assert isinstance(spec.scene.source, Clevr)
    return spec.scene.source.stated()


def _attacked(spec: JobSpec, folder: Path) -> SceneRecord:
    record = _record(spec)
    moved = load_file(folder / PERTURBATION)
    if not can_carry(spec.attack.renderer, tuple(moved)):
        return record
    scene = described(spec.scene, moved)
    return record_after(record, scene)


def fooled_first(
    program: Program,
    before: Mapping[int, Tensor],
    after: Mapping[int, Tensor],
    cells_before: Sequence[int],
    cells_after: Sequence[int],
) -> int:
    """Returns the number of the function that was fooled first; the last one if no mask says otherwise.

    before and after: what functions attend to, by number, masks [h, w] in [0,1]. cells: the number of each object's
    cell, row by row, before and after the attack, which may have moved it.
    """
    for number in sorted(before):
        old = before[number].flatten()[list(cells_before)]
        new = after[number].flatten()[list(cells_after)]
        if program.types[number] == "object":
            changed = bool(old.argmax() != new.argmax())
        else:
            changed = bool((((old >= HALF) != (new >= HALF)) & ((new - old).abs() > LEAST)).any())
        if changed:
            return number
    return len(program.nodes) - 1
