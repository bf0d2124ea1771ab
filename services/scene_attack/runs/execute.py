"""Runs one job from spec to result in this process. The worker and `scene-attack run` both call it.

Of an attack that was ended before its time, `best_so_far` keeps the best of its checkpoint.
"""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from pydantic import BaseModel, ConfigDict, Field
from safetensors.torch import save_file
from torch import Tensor

from scene_attack.analysis.attribution import of_subsets
from scene_attack.analysis.expectation import held_over
from scene_attack.analysis.images import answer, beyond, magnified, of_float_images, of_groups, of_images, save_png
from scene_attack.analysis.records import Answer, HeldOver
from scene_attack.analysis.subsets import ScoredImage, scored, subsets
from scene_attack.attacks.leave_out import LeftOut, leave_out
from scene_attack.attacks.limits import at_epsilon
from scene_attack.attacks.problem import AttackProblem
from scene_attack.attacks.run import AttackRun, check_masking, run_attack
from scene_attack.attacks.run import best as best_of_checkpoint
from scene_attack.attacks.trace import TraceRow
from scene_attack.errors import Cancelled
from scene_attack.plugins import loaded_plugins
from scene_attack.process import versions
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.physical_change import Change, change_images, changes_in_words
from scene_attack.rendering.plan import Plan
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.runs.analyse import Report, Subject, analyse, not_made
from scene_attack.runs.prepare import Prepared, by_task, lit_by_map, prepare, prepare_exactly
from scene_attack.runs.result import (
    ATTACKED,
    BEST_SO_FAR,
    ORIGINAL,
    PERTURBATION,
    RESULT,
    AtEpsilon,
    JobVerdict,
    JobWarning,
    Measured,
    Noise,
    Provenance,
    Result,
    StoredChange,
    subset_image,
)
from scene_attack.runs.spec import JobSpec
from scene_attack.runs.task_parts import ResultPart
from scene_attack.scenes.library import Library
from scene_attack.targets.info import TARGETS

_VERSIONED = ("scene-attack", "torch", "numpy", "pyrender-maintained", "PyOpenGL", "trimesh", "OpenEXR", "safetensors")


class Progress(BaseModel):
    """The progress of a running job: its phase, the steps taken, and the largest number of steps.

    `row` is the newest row of the trace in the phase "attacking", otherwise None. `analysis` is the name of the
    analysis in progress, or "leave_out" before the attack; its images are then counted instead of steps.
    """

    phase: Literal["loading", "attacking", "analysing"]
    step: int = 0
    steps: int
    row: TraceRow | None = None
    analysis: str | None = None


def execute(
    spec: JobSpec,
    out: Path,
    library: Library,
    *,
    progress: Callable[[Progress], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
    checkpoint: Path | None = None,
    checked: Callable[[JobSpec, Sequence[JobWarning]], None] = lambda _, __: None,
) -> Result:
    """Runs a job and writes its files into `out`.

    The files are result.json, trace.json, perturbation.safetensors (one tensor for each group), original.png,
    attacked.png, and perturbation.png (the difference times 5, plus 128); the images of those subsets of the groups
    that are neither empty nor all (`subset_image`), and those of the changes (`Change.images`); and those of the task
    (`tasks`). `progress` is called in every phase and with every row of the trace,
    `checked` once before the attack with the spec as it runs and the warnings. The attack writes the file `checkpoint`
    every few seconds and resumes from it.
    Raises InvalidRequest, JobFailure, or Cancelled once `cancelled()`, which is called before every rendering, is true.
    """

    def interrupt() -> None:
        if cancelled():
            raise Cancelled

    def report(phase: Literal["loading", "analysing"], name: str, done: int, of: int) -> None:
        interrupt()
        progress(Progress(phase=phase, step=done, steps=of, analysis=name))

    steps = (spec.attack.steps + 1) * (spec.attack.restarts + 1) - 1
    progress(Progress(phase="loading", steps=steps))
    interrupt()
    prepared = prepare(spec, library)
    checked(prepared.spec, prepared.settled.warnings)
    problem = _problem(prepared, interrupt)
    left_out = None
    if spec.attack.leave_out:
        left_out = leave_out(problem, spec.attack.leave_out, partial(report, "loading", "leave_out"))
        problem = left_out.without

    def on_row(row: TraceRow) -> None:
        progress(Progress(phase="attacking", step=row.step, steps=steps, row=row))

    run = AttackRun.begin_or_resume(problem, spec.attack, prepared.verifier, checkpoint, on_row)
    run_attack(run)
    settings = dict(run.settings)
    if spec.attack.masking_check and not run.verified:
        settings["masking"] = check_masking(run, spec.attack.masking_check)
    if left_out is not None:
        settings["leave_out"] = left_out.settings
    progress(Progress(phase="analysing", step=run.step, steps=steps))
    interrupt()
    return _write(prepared, run, settings, out, partial(report, "analysing"), left_out)


def _problem(prepared: Prepared, interrupt: Callable[[], None]) -> AttackProblem:
    attack = prepared.spec.attack
    return AttackProblem.of(
        prepared.renderer,
        prepared.target,
        prepared.settled.goal,
        prepared.limits,
        seed=prepared.spec.seed,
        loss=attack.objective,
        distance_weight=attack.distance_weight,
        expectation=attack.expectation,
        surrogate=prepared.surrogate,
        counts=prepared.verifier.counts,
        interrupt=interrupt,
    )


def _write(
    prepared: Prepared,
    run: AttackRun,
    settings: dict[str, object],
    out: Path,
    report: Report,
    left_out: LeftOut | None,
) -> Result:
    out.mkdir(parents=True, exist_ok=True)
    cost = run.cost()  # before the looks that belong to the report and not to the attack
    assert run.best is not None
    stored, verifier, settled, original = run.stored, prepared.verifier, prepared.settled, prepared.original
    attacked = scored(verifier, stored)
    ends = original, attacked
    rows = subsets(verifier, settled.goal, stored, *ends, lambda row, image: save_png(image, out / subset_image(row)))
    verdict, part = _verdict(prepared, run, attacked, out)
    asked = prepared.spec.analysis
    analyses = analyse(Subject(prepared, stored, *ends, verdict.verified), asked, out, report)
    held = _held_over(prepared, stored, partial(report, "expectation"))
    answer_of = partial(answer, labels=prepared.target.labels, goal=settled.goal)
    result = Result(
        spec=prepared.spec.model_dump(mode="json"),
        verdict=verdict,
        warnings=[*settled.warnings, *not_made(asked, verdict.verified)],
        original=answer_of(original.logits),
        attacked=answer_of(attacked.logits),
        in_loop=answer_of(run.best.scores),
        change=_stored_change(prepared, run, attacked),
        plan=_plan(prepared, left_out),
        measured=Measured(
            image_error=_image_error(run, attacked.exact), sampled_error=run.sampled_error, settings=settings
        ),
        cost=cost,
        subsets=rows,
        attribution=of_subsets(rows),
        expectation=held,
        analyses=analyses,
        tasks=by_task(prepared, part),
        trace=run.trace,
        provenance=provenance(prepared),
    )
    _save_change(prepared, stored, attacked.saved, out)
    trace = ",\n".join(row.model_dump_json() for row in run.trace)
    (out / "trace.json").write_text(f"[{trace}]\n", "utf-8")
    (out / RESULT).write_text(result.model_dump_json(indent=1) + "\n", "utf-8")
    return result


def _save_change(prepared: Prepared, stored: Parameters, attacked: Tensor, out: Path) -> None:
    """Writes the files into the directory `out`. attacked: the exact image of `stored`, uint8 [H, W, 3]."""
    save_png(prepared.original.saved, out / ORIGINAL)
    save_png(attacked, out / ATTACKED)
    save_png(magnified(prepared.original.saved, attacked), out / "perturbation.png")
    for name, image in change_images(prepared.renderer, stored).items():
        save_png(image, out / name)
    _save_perturbation(stored, prepared.renderer, out / PERTURBATION)


def _save_perturbation(perturbation: Parameters, renderer: Renderer, path: Path) -> None:
    """Writes one tensor for each group: its change from the scene's own values, `_described` as metadata."""
    tensors = {group: value.contiguous() for group, value in perturbation.items()}
    # One entry: the library writes several in an order of its own, and the same job gives the same bytes.
    save_file(tensors, path, metadata={"groups": _described(perturbation, renderer)})


def _described(perturbation: Parameters, renderer: Renderer) -> str:
    """JSON: for each group its unit, its axes and, where they have names, its coordinates in flat order."""
    declared = {group.name: group for group in RENDERERS[renderer.name].groups}
    description = {
        group: {
            "unit": declared[group].unit,
            "axes": list(declared[group].shape),
            "names": renderer.names(group),
            "values": "change from the scene's own values",
        }
        for group in sorted(perturbation)
    }
    return json.dumps(description, ensure_ascii=False)


def _held_over(prepared: Prepared, stored: Parameters, tick: Callable[[int, int], None]) -> HeldOver | None:
    """How the stored perturbation holds over the range that its attack averaged over; None if it did not."""
    asked = prepared.spec.attack.expectation
    if asked is None:
        return None
    goal, seed = prepared.settled.goal, prepared.spec.seed
    return held_over(prepared.verifier, goal, prepared.right, stored, asked, seed=seed, tick=tick)


def _verdict(
    prepared: Prepared, run: AttackRun, attacked: ScoredImage, out: Path
) -> tuple[JobVerdict, ResultPart | None]:
    """The verdict, and what the task adds to the result, whose files are written into `out`."""
    settled, original, labels = prepared.settled, prepared.original, prepared.target.labels
    goal, first = settled.goal, int(original.logits.argmax())
    outcome, part = prepared.task.judge(settled, prepared.renderer.name, run.stored, original, attacked, out)
    noise = _noise(prepared, run.stored)
    verified = bool(goal.fooled(attacked.logits)) and (noise is None or noise.share == 1)
    if not verified and outcome in ("fooled", "changed"):  # under its own seed alone
        outcome = "held"
    verdict = JobVerdict(
        outcome=outcome,
        truth=[labels[i] for i in settled.truth],
        right_before=first in settled.truth if settled.truth else None,
        fooled=run.fooled,
        verified=verified,
        stopped=run.stopped,
        leave=labels[first] if first in goal.leave else None,
        labels_to_leave=[labels[i] for i in goal.leave],
        reach=None if goal.reach is None else labels[goal.reach],
        noise=noise,
    )
    return verdict, part


def _noise(prepared: Prepared, stored: Parameters) -> Noise | None:
    """The verdict under other seeds, where the renderer's images have noise."""
    goal, verifier = prepared.settled.goal, prepared.verifier
    images = list(verifier.reseeded(stored))
    if not images:
        return None
    met = [bool(goal.fooled(verifier.logits(to_bytes(image)))) for image in images]
    deviation = torch.stack(images).double().std(dim=0)
    return Noise(seeds=len(met), share=sum(met) / len(met), standard_error=float(deviation.square().mean().sqrt()))


def _stored_change(prepared: Prepared, run: AttackRun, attacked: ScoredImage) -> StoredChange:
    assert run.best is not None
    original, limit = prepared.original, prepared.spec.attack.truncation
    return StoredChange(
        step=run.best.step,
        float_perceptibility=of_float_images(original.exact, attacked.exact),
        perceptibility=of_images(original.saved, attacked.saved),
        group_perceptibility=of_groups(prepared.renderer.name, run.stored),
        at_epsilon={
            group: AtEpsilon(coordinates=int(values.sum()), share=float(values.double().mean()))
            for group, values in at_epsilon(run.stored, run.problem.limits.epsilon).items()
        },
        beyond_truncation=None if limit is None else beyond(original.saved, attacked.saved, limit),
        things=changes_in_words(prepared.scene, prepared.renderer, run.stored),
    )


def _plan(prepared: Prepared, left_out: LeftOut | None) -> Plan:
    plan = prepared.plan()
    return plan if left_out is None else left_out.in_plan(plan)


@torch.no_grad()
def _image_error(run: AttackRun, exact: Tensor) -> float:
    """Largest difference between the exact image and the loop's image of the stored perturbation, before truncation."""
    assert run.best is not None
    moved = run.problem.layout.unflatten((run.problem.initial + run.best.delta)[None])
    return float((run.problem.renderer.render(moved)[0].double() - exact.double()).abs().max())


def provenance(prepared: Prepared) -> Provenance:
    """The inputs and versions on which the bits of a job's result depend, besides its spec."""
    return Provenance(
        seed=prepared.spec.seed,
        backend=prepared.backend,
        versions=versions(*_VERSIONED),
        scene_sha256=prepared.scene.sha256,
        weights_sha256=prepared.target.weights_sha256,
        surrogate_sha256=None if prepared.surrogate is None else prepared.surrogate.target.weights_sha256,
        card_sha256=TARGETS[prepared.spec.target.name].info.card_sha256,
        meshes={
            thing.mesh: mesh.sha256
            for thing, mesh in zip(prepared.spec.scene.objects, prepared.scene.meshes, strict=True)
        },
        credits=prepared.scene.credits(lit_by_map(prepared.spec)),
        plugins=_plugins(prepared.spec),
    )


def _plugins(spec: JobSpec) -> dict[str, str]:
    """Package to sha256 of the plug-ins of others that this job's method, renderers or target come from."""
    used = {
        ("method", spec.attack.method),
        ("renderer", spec.attack.renderer),
        ("renderer", spec.attack.base_renderer),
        ("target", spec.target.name),
        ("target", spec.attack.guide),
    }
    others = [plugin for plugin in loaded_plugins() if not plugin.ours and plugin.adds & used]
    return {plugin.package: plugin.sha256 for plugin in others if plugin.sha256 is not None}


class BestSoFar(BaseModel):
    """The best perturbation of an attack that did not run to its end. It is no result.

    verified: the network's answer to the perturbation, rendered by the exact path and rounded to 8 bits, meets the
    goal.
    """

    model_config = ConfigDict(extra="forbid")

    step: int = Field(description="the step at which the perturbation was found")
    steps: int = Field(description="the steps until the checkpoint that it is of")
    queries: int = Field(description="images that the target classified until then")
    verified: bool
    original: Answer
    attacked: Answer
    float_perceptibility: float
    perceptibility: float
    changes: list[Change]


def best_so_far(spec: JobSpec, path: Path, out: Path, library: Library) -> BestSoFar | None:
    """Renders the best perturbation of the checkpoint `path` and asks the network; returns None without a checkpoint.

    Writes best-so-far.json and what was changed into `out`. Raises what `prepare_exactly` does.
    """
    checkpoint = best_of_checkpoint(path)
    if checkpoint is None:
        return None
    prepared = prepare_exactly(spec, library)
    original, goal, labels = prepared.original, prepared.settled.goal, prepared.target.labels
    stored = {group: checkpoint.stored[group] for group in prepared.spec.attack.groups}
    attacked = scored(prepared.verifier, stored)
    best = BestSoFar(
        step=checkpoint.stored_step,
        steps=checkpoint.step,
        queries=checkpoint.queries,
        verified=bool(goal.fooled(attacked.logits)) and prepared.verifier.holds(stored, goal),
        original=answer(original.logits, labels, goal),
        attacked=answer(attacked.logits, labels, goal),
        float_perceptibility=of_float_images(original.exact, attacked.exact),
        perceptibility=of_images(original.saved, attacked.saved),
        changes=changes_in_words(prepared.scene, prepared.renderer, stored),
    )
    _save_change(prepared, stored, attacked.saved, out)
    (out / BEST_SO_FAR).write_text(best.model_dump_json(indent=1) + "\n", "utf-8")
    return best
