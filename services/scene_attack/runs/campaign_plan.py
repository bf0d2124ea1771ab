"""A campaign between its request and its table, without the record and without torch.

A campaign goes through three states, whoever drives it: the command line in one process (`campaign_run`), or the
supervisor of a service, which keeps what is known in the record (`scene_attack_service.jobs.campaigns`).

1. Selecting: the networks are asked about `views`, the campaign's scenes as a renderer draws them.
2. Running: `plan` chooses the views to attack from these first answers, and plans the jobs on them, always in the same
   order. The result of an earlier job is taken if it is `reusable`, and each job that has ended becomes a case
   (`case_of`).
3. Finished: every job has its case, and the table is made of the cases.
"""

import hashlib
import json
import operator
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self

from pydantic import BaseModel, ConfigDict, Field

from scene_attack import disk
from scene_attack.analysis.campaign_table import Case, Curves, MeanCurves, Table, to_csv, to_latex
from scene_attack.attacks.attack import Attack
from scene_attack.extras import extra
from scene_attack.rendering.declaration import IMAGE_OF
from scene_attack.runs.campaign_spec import CampaignSpec, Grid, Selection
from scene_attack.runs.result import Provenance, Result, success
from scene_attack.runs.spec import JobSpec, TargetChoice, attack_name, digest, scene_name
from scene_attack.runs.task_parts import Member, PlanParts


@dataclass(frozen=True)
class View:
    """A scene as a renderer draws it, which the selection pass shows to a target."""

    number: int
    grid: int | None
    """The number of its grid; None for a single job's view."""
    place: int
    """The number of the scene in its grid, or of the job among the campaign's jobs."""
    member: Member
    """The scene, and what is asked about it."""
    probe: JobSpec
    """A job with this scene and target, and an attack on this renderer's image."""
    selection: Selection | None
    """The grid's rules; None if the view's jobs are run whatever the answer."""

    @property
    def image_renderer(self) -> str:
        """The renderer of the original image."""
        return image_renderer(self.probe)

    @property
    def shared(self) -> bool:
        """Whether the same views are attacked of every target of the grid."""
        return self.selection is not None and self.selection.shared

    @property
    def group(self) -> tuple[int | None, str, str]:
        """The views that are selected together: those of one grid and renderer, and of one target unless shared."""
        return self.grid, "" if self.shared else self.probe.target.name, self.image_renderer

    @property
    def unit(self) -> tuple[int, str]:
        """The views that are attacked or not together: those of a scene for all targets if shared, else this alone."""
        return (self.place if self.shared else self.number), self.image_renderer


def image_renderer(spec: JobSpec) -> str:
    """The renderer of a job's original image."""
    return spec.attack.base_renderer or spec.attack.renderer


def views(campaign: CampaignSpec) -> list[View]:
    """All views of a campaign: by grid, scene, target and renderer, then those of the single jobs."""
    result: list[View] = []
    for index, grid in enumerate(campaign.grids):
        for number, member in enumerate(grid.members()):
            for probe in _probes(grid, member):
                result.append(View(len(result), index, number, member, probe, grid.selection))
    for number, job in enumerate(campaign.jobs):
        result.append(View(len(result), None, number, Member(job.scene, job.target.ask), job, None))
    return result


def _probes(grid: Grid, member: Member) -> Iterator[JobSpec]:
    for target in grid.targets:
        seen = set()
        for column in grid.attacks:
            probe = job_of(grid, member, target, column.attack)
            if image_renderer(probe) not in seen:
                seen.add(image_renderer(probe))
                yield probe


def job_of(grid: Grid, member: Member, target: TargetChoice, attack: Attack) -> JobSpec:
    """The job of a grid with this scene, what is asked about it, this target and attack, and seed 0."""
    return JobSpec(
        scene=member.scene,
        target=target if member.ask is None else target.model_copy(update={"ask": member.ask}),
        goal=grid.goal,
        attack=attack,
        tolerance=grid.tolerance,
        analysis=grid.analysis,
    )


UNKNOWN = "nobody knows its truth"


class FirstAnswer(BaseModel):
    """The network's answer to the exact image of a view, as a worker found it."""

    model_config = ConfigDict(extra="forbid")

    view: int
    label: str | None = None
    confidence: float | None = None
    truth: list[str] = Field([], description="the labels that are right; empty if nobody knows them")
    refused: str | None = Field(None, description="why the view cannot be attacked at all")
    tasks: PlanParts = Field({}, exclude_if=operator.not_, description="what the network's task adds to a plan")
    spec: JobSpec | None = Field(None, description="the probe as it would run, with scene and goal filled in")
    identity: str | None = Field(None, description="digest of scene, weights, backend, versions and answer; for reuse")

    @property
    def right(self) -> bool:
        """Whether the truth is known and the answer is right."""
        return self.label in self.truth


class ChosenView(BaseModel):
    """A view of a campaign, and whether it is attacked."""

    model_config = ConfigDict(extra="forbid")

    number: int
    scene: str = Field(description="short name of the scene's meshes")
    asked: list[str] = Field([], exclude_if=operator.not_, description="what is asked about it, in words")
    azimuth: float = Field(description="of the camera, radians")
    target: str
    renderer: str = Field(description="the renderer of the image")
    label: str | None = Field(description="the network's first answer")
    confidence: float | None
    truth: list[str]
    right: bool
    chosen: bool
    why: str = Field(description="why the view is not attacked; empty for a chosen one")


def meshes_in(views: Sequence[View]) -> set[str]:
    """The names of all meshes in the views' scenes."""
    return {thing.mesh for view in views for thing in view.probe.scene.objects}


def choose(
    views: Sequence[View], answers: Mapping[int, FirstAnswer], titles: Mapping[str, str] | None = None
) -> list[ChosenView]:
    """Applies each grid's rules to the views of each target and renderer, and returns all views in their order.

    Of equally confident views the earlier one is taken. A view without an answer is not chosen. `titles` are those of
    uploaded meshes, by name.
    """
    titles = _distinct(titles or {})
    why = {view.number: _unfit(view, answers.get(view.number)) for view in views}
    for group in dict.fromkeys(view.group for view in views):
        units: dict[tuple[int, str], list[View]] = {}
        for view in views:
            if view.group == group:
                units.setdefault(view.unit, []).append(view)
        fit = [unit for unit in units.values() if not any(why[view.number] for view in unit)]
        passed = _not_among_the_preferred([unit[0] for unit in fit], answers)
        for unit in units.values():
            reason = passed.get(unit[0].number, "") or _of_another(unit, why)
            why |= {view.number: why[view.number] or reason for view in unit}
    return [_record(view, answers.get(view.number), why[view.number], titles) for view in views]


def _distinct(titles: Mapping[str, str]) -> dict[str, str]:
    """The titles; one that several uploads have is followed by the beginning of their hash, as tables are by scene."""
    count = Counter(titles.values())
    return {name: title if count[title] == 1 else f"{title} ({name[:14]})" for name, title in titles.items()}


def _unfit(view: View, answer: FirstAnswer | None) -> str:
    if answer is None:
        return "its first answer could not be found"
    if answer.refused is not None:
        return answer.refused
    if (why := view.member.refused(answer.tasks)) is not None:
        return why
    rules = view.selection
    if rules is None:
        return ""
    if rules.right and not answer.truth:
        return UNKNOWN
    if rules.right and not answer.right:
        return f"the network says {answer.label}, which is wrong"
    if _confidence(answer) < rules.least_confidence:
        return f"the network is less sure than {rules.least_confidence:g}"
    return ""


def nothing_chosen(views: Sequence[ChosenView]) -> str | None:
    """The most frequent reasons why a campaign attacks none of its views, in a sentence; None if it attacks any."""
    if not views or any(view.chosen for view in views):
        return None
    counted = Counter(view.why for view in views).most_common(3)
    reasons = "; ".join(f"{why} ({count:,} of {len(views):,})" for why, count in counted)
    hint = " The field goal.truth of a grid states it." if any(why == UNKNOWN for why, _ in counted) else ""
    return f"No view is attacked: {reasons}.{hint}"


def _of_another(unit: Sequence[View], why: Mapping[int, str]) -> str:
    """The reason for which one of these views is not attacked, and so none; empty if there is none."""
    return next((f"of {view.probe.target.name}: {why[view.number]}" for view in unit if why[view.number]), "")


def _not_among_the_preferred(own: Sequence[View], answers: Mapping[int, FirstAnswer]) -> dict[int, str]:
    rules = own[0].selection if own else None
    if rules is None:
        return {}
    listed = rules.prefer == "listed"
    ranked = sorted(own, key=lambda view: (0.0 if listed else -_confidence(answers[view.number]), view.number))
    meshes: Counter[str] = Counter()
    classes: Counter[tuple[str, ...]] = Counter()
    taken = 0
    why: dict[int, str] = {}
    for view in ranked:
        mesh = _mesh(view)
        # the class of a view whose truth is not known is the network's answer
        truth = tuple(answers[view.number].truth) or (str(answers[view.number].label),)
        if rules.per_mesh is not None and meshes[mesh] >= rules.per_mesh:
            why[view.number] = _more(rules, rules.per_mesh, " of its mesh")
        elif rules.per_class is not None and classes[truth] >= rules.per_class:
            why[view.number] = _more(rules, rules.per_class, " of its class")
        elif rules.most is not None and taken >= rules.most:
            why[view.number] = _more(rules, rules.most, "")
        else:
            meshes[mesh] += 1
            classes[truth] += 1
            taken += 1
    return why


def _more(rules: Selection, count: int, whose: str) -> str:
    which = "earlier" if rules.prefer == "listed" else "more confident"
    return f"there is {_a(which)} view{whose}" if count == 1 else f"there are {count} {which} views{whose}"


def _a(word: str) -> str:
    return f"an {word}" if word[0] in "aeiou" else f"a {word}"


def _mesh(view: View) -> str:
    return ",".join(thing.mesh for thing in view.probe.scene.objects)


def _confidence(answer: FirstAnswer) -> float:
    return 0.0 if answer.confidence is None else answer.confidence


def _record(view: View, answer: FirstAnswer | None, why: str, titles: Mapping[str, str]) -> ChosenView:
    return ChosenView(
        number=view.number,
        scene=scene_name({"scene": {"objects": [{"mesh": thing.mesh} for thing in view.probe.scene.objects]}}, titles),
        asked=[] if view.member.ask is None else list(view.member.ask.names),
        azimuth=view.probe.scene.camera.azimuth,
        target=view.probe.target.name,
        renderer=view.image_renderer,
        label=None if answer is None else answer.label,
        confidence=None if answer is None else answer.confidence,
        truth=[] if answer is None else answer.truth,
        right=answer is not None and answer.right,
        chosen=not why,
        why=why,
    )


class Planned(Protocol):
    """A planned job, as each driver keeps it: its row and column of the table, and what a result must share with it."""

    target: str
    attack: str
    right: bool
    """Whether the truth is known and the network's first answer was right."""
    identity: str | None
    """The `identity` of the inputs at the selection."""
    digest: str
    """The digest of the request."""


@dataclass
class PlannedJob:
    """A planned job with its request and the number of the view that it attacks; implements `Planned`."""

    target: str
    attack: str
    right: bool
    identity: str | None
    digest: str
    view: int
    spec: JobSpec

    @classmethod
    def on(cls, view: View, answer: FirstAnswer, attack: str, spec: JobSpec) -> Self:
        """The job on a view with the network's first answer."""
        return cls(spec.target.name, attack, answer.right, answer.identity, digest(spec), view.number, spec)


def plan(
    campaign: CampaignSpec,
    views: Sequence[View],
    answers: Mapping[int, FirstAnswer],
    titles: Mapping[str, str] | None = None,
) -> tuple[list[ChosenView], list[PlannedJob]]:
    """All views with whether each is attacked, as `choose` has them, and the jobs on those that are."""
    chosen = choose(views, answers, titles)
    attacked = [view for view in views if chosen[view.number].chosen]
    return chosen, list(jobs(campaign, attacked, answers))


def jobs(campaign: CampaignSpec, attacked: Iterable[View], answers: Mapping[int, FirstAnswer]) -> Iterator[PlannedJob]:
    """The jobs on these views, in their order; on each view by attack, then by seed.

    Scene and goal of a request are those that the view's answer is of, with all that was left open filled in.
    """
    for view in attacked:
        answer = answers.get(view.number) or FirstAnswer(view=view.number)
        probe = answer.spec or view.probe
        if view.grid is None:
            yield PlannedJob.on(view, answer, attack_name(probe.model_dump(mode="json")), probe)
            continue
        grid = campaign.grids[view.grid]
        for column in grid.attacks:
            if (column.attack.base_renderer or column.attack.renderer) != view.image_renderer:
                continue
            for seed in grid.seeds:
                spec = probe.model_copy(update={"attack": column.attack, "seed": seed})
                yield PlannedJob.on(view, answer, column.name, spec)


_NOT_IDENTITY = ("seed", "credits", "plugins")
"""Fields of the provenance that belong to the request, or change no bits, or are compared otherwise."""


def identity(provenance: Provenance, label: str, confidence: float) -> str:
    """Hex SHA-256 of what a result's bits depend on besides the request, and of the network's first answer.

    The provenance has assets, weights, backend and versions. The answer tells networks apart whose weights are not at
    hand to be hashed: those behind a URL, or inside a factory's object.
    """
    values = provenance.model_dump(mode="json", exclude=set(_NOT_IDENTITY))
    values["first_answer"] = [label, confidence]
    # the same picture, whether a renderer draws it or its pixels are attacked
    values["backend"] = provenance.backend.removeprefix(IMAGE_OF)
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def reusable(result: Result, planned: Planned) -> bool:
    """Whether the result is of the planned job's request, and of the inputs and backend that its view had.

    The result of a plug-in's attack is not: its code may have changed since the first answers were found.
    """
    return (
        planned.identity is not None
        and not result.provenance.plugins
        and identity(result.provenance, result.original.label, result.original.confidence) == planned.identity
        and digest(JobSpec.model_validate(result.spec)) == planned.digest
    )


def case_of(planned: Planned, result: Result, *, run_seconds: float | None = None, reused: bool = False) -> Case:
    """The case of a job that ran to its end."""
    right = bool(result.verdict.right_before)
    rows = [row for row in result.trace if row.step == result.change.step]
    return Case(
        target=planned.target,
        attack=planned.attack,
        state="succeeded",
        right=right,
        outcome=result.outcome,
        epsilon_bound=result.change.epsilon_bound,
        success=success(result),
        loop_success=right and result.verdict.fooled,
        perceptibility=result.p,
        loop_perceptibility=rows[-1].perceptibility if rows else None,
        truncated=result.cost.truncated,
        survival=None if result.analyses.survival is None else result.analyses.survival.share,
        second_opinion={
            opinion.renderer: opinion.outcome
            for opinion in result.analyses.second_opinion or ()
            if opinion.outcome is not None
        },
        queries=result.cost.queries,
        seconds=result.cost.seconds,
        run_seconds=run_seconds,
        reused=reused,
    )


def unfinished(planned: Planned, state: str) -> Case:
    """The case of a job that failed or was cancelled, as `state` says."""
    return Case(target=planned.target, attack=planned.attack, state=state, right=planned.right)


def curves_of(result: Result) -> Curves:
    """The curves of a result's trace."""
    return Curves(
        loss=[row.loss for row in result.trace],
        advantage=[row.advantage for row in result.trace],
        distance=[row.distance for row in result.trace],
    )


def curves_record(curves: Curves) -> dict[str, Any]:
    """The curves as JSON with six significant digits, which is what a drawing can show."""
    return {name: [float(f"{value:.6g}") for value in values] for name, values in curves.model_dump().items()}


class CampaignResult(BaseModel):
    """The content of `table.json`: the table of the jobs that have ended, the mean curves, and all views."""

    model_config = ConfigDict(extra="forbid")

    table: Table
    curves: list[MeanCurves] = Field(description="means of the traces of all cases, by step")
    views: list[ChosenView] = Field(description="every view, with the first answer and why it is not attacked")


def write(result: CampaignResult, out: Path) -> list[Path]:
    """Writes table.json, table.csv, table.tex and curves.png into a folder, and returns their paths.

    Raises MissingExtra if matplotlib is not installed, when all but the curves are written.
    """
    texts = {
        "table.json": result.model_dump_json(indent=1) + "\n",
        "table.csv": to_csv(result.table),
        "table.tex": to_latex(result.table),
    }
    for name, text in texts.items():
        disk.write(out / name, text.encode())
    with extra("export", "curves.png"):
        from scene_attack.analysis.campaign_figure import draw  # matplotlib takes a second to import
    draw(result.table, result.curves, out / "curves.png")
    return [out / name for name in (*texts, "curves.png")]
