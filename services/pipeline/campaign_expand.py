"""Expands a campaign into the views that are asked for and, of those chosen, into jobs; always in the same order."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

from services.attacks.spec import AttackSettings
from services.pipeline.campaign_questions import Member
from services.pipeline.campaign_spec import CampaignSpec, Grid, Selection
from services.pipeline.names import attack_name
from services.pipeline.spec import JobSpec, TargetChoice
from services.questions.records import QuestionRecord


@dataclass(frozen=True)
class View:
    """A scene as a renderer draws it, which the selection pass shows to a target."""

    number: int
    grid: int | None
    """The number of its grid; None for a single job's view."""
    member: int
    """The number of the scene in its grid, or of the job among the campaign's jobs."""
    probe: JobSpec
    """A job with this scene and target, and an attack on this renderer's image."""
    selection: Selection | None
    """The grid's rules; None if the view's jobs are run whatever the answer."""
    asked: tuple[QuestionRecord, ...] = ()
    """The generated questions that are asked about it."""

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
        return (self.member if self.shared else self.number), self.image_renderer


@dataclass(frozen=True)
class PlannedJob:
    """A job of a campaign: its row and column of the table, and the view that it attacks."""

    target: str
    attack: str
    view: int
    spec: JobSpec


def image_renderer(spec: JobSpec) -> str:
    """The renderer of a job's original image."""
    return spec.attack.base_renderer or spec.attack.renderer


def views(campaign: CampaignSpec) -> list[View]:
    """All views of a campaign: by grid, scene, target and renderer, then those of the single jobs."""
    found: list[View] = []
    for index, grid in enumerate(campaign.grids):
        for number, member in enumerate(grid.members()):
            for probe in _probes(grid, member):
                found.append(View(len(found), index, number, probe, grid.selection, member.questions))
    for number, job in enumerate(campaign.jobs):
        found.append(View(len(found), None, number, job, None))
    return found


def filled(view: View, spec: JobSpec | None) -> View:
    """The view with the scene and the goal as they run."""
    return view if spec is None else replace(view, probe=spec)


def _probes(grid: Grid, member: Member) -> Iterator[JobSpec]:
    for target in grid.targets:
        seen = set()
        for column in grid.attacks:
            probe = job_of(grid, member, target, column.attack)
            if image_renderer(probe) not in seen:
                seen.add(image_renderer(probe))
                yield probe


def job_of(grid: Grid, member: Member, target: TargetChoice, attack: AttackSettings) -> JobSpec:
    """The job of a grid with this scene, its questions, this target and attack, and seed 0."""
    words = tuple(one.question for one in member.questions)
    if len(words) == 1:
        target = target.model_copy(update={"question": words[0]})
    elif words:
        target = target.model_copy(update={"questions": words})
    return JobSpec(
        scene=member.scene,
        record=member.record,
        target=target,
        goal=grid.goal,
        attack=attack,
        tolerance=grid.tolerance,
        analysis=grid.analysis,
    )


def jobs(campaign: CampaignSpec, found: Collection[View]) -> Iterator[PlannedJob]:
    """The jobs on these views, in their order; on each view by attack, then by seed."""
    for view in found:
        probe = view.probe
        if view.grid is None:
            yield PlannedJob(probe.target.name, attack_name(probe.model_dump(mode="json")), view.number, probe)
            continue
        grid = campaign.grids[view.grid]
        for column in grid.attacks:
            if (column.attack.base_renderer or column.attack.renderer) != view.image_renderer:
                continue
            for seed in grid.seeds:
                spec = probe.model_copy(update={"attack": column.attack, "seed": seed})
                yield PlannedJob(probe.target.name, column.name, view.number, spec)
