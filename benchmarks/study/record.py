"""The compact record of a campaign that the study commits: one line for each job, the mean curves, and the provenance.

Rates, means and counts are not in the record: the page computes them from the outcome of each job.
"""

from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, model_validator

from scene_attack.analysis.campaign_table import Case, MeanCurves, Table, table
from scene_attack.analysis.verdict import SUCCESS, Verdict
from scene_attack_accuracy.tables import rows_as_json


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Asked(_Record):
    """A question of a job. A job that failed has no answers of the network, and none about what came of it."""

    text: str
    family: str
    """The kind of its family, such as "two_hop"."""
    kind: str
    """Of the answers that it asks for: boolean, integer, or an attribute."""
    functions: tuple[str, ...]
    """Those of its program, in order."""
    right: str
    right_after: str | None = None
    """The right answer to the attacked scene; None where the question is ill-posed there."""
    before: str | None = None
    before_confidence: float | None = None
    after: str | None = None
    after_confidence: float | None = None
    of_kind: bool | None = None
    """Whether the answer after the attack is of the kind that is asked for."""
    outcome: str | None = None
    first: int | None = None
    """The number of the function that was fooled first (benchmarks.study.recording); None if it was not fooled."""

    @property
    def fooled(self) -> bool:
        """Whether the attack succeeded on it."""
        return self.outcome == SUCCESS


class Around(_Record):
    """Fresh variations of an attack over a range, which no step of it has seen, each rendered afresh."""

    views: int
    right: int
    """Those that the network has right without the perturbation; only these can be fooled."""
    fooled: int


class Job(_Record):
    """One job: what was attacked, what the network said before, in the loop and afterwards, and what it cost.

    A job that failed has a state other than "succeeded" and no answers after `before`.
    """

    target: str
    attack: str
    mesh: str
    azimuth: float
    seed: int
    truth: tuple[str, ...]
    before: str
    before_confidence: float
    state: str = "succeeded"
    after: str | None = None
    after_confidence: float | None = None
    outcome: str | None = None
    fooled: bool = False
    """Whether an image in the loop, truncated, met the goal: the paper's count."""
    verified: bool = False
    """Whether the perturbation rendered afresh, to 8 bits, meets the goal."""
    p: float | None = None
    """Perceptibility of the exact image before it is rounded."""
    p_saved: float | None = None
    """Perceptibility of the exact image as saved, of 8 bits."""
    p_loop: float | None = None
    """Perceptibility of the truncated image in the loop at the stored step."""
    step: int | None = None
    steps: int | None = None
    queries: int | None = None
    seconds: float | None = None
    truncated: int | None = None
    lowered: bool | None = None
    """Whether the objective that the method minimises was lower at some step than at the start."""
    covered: int | None = None
    """Pixels that show an object; the torch renderer's plan counts them."""
    pixels: int | None = None
    """Pixels of the image, where `covered` is known."""
    around: Around | None = None
    """What came of an attack over a range of views."""
    survival: Around | None = None
    """What came of a verified adversary before cameras."""
    second_opinion: dict[str, Verdict] = {}
    """What a verified adversary came to when other renderers drew it, by renderer."""
    request: str
    scene: str = ""
    questions: tuple[Asked, ...] = ()
    """What was asked about the scene; several questions were attacked together."""

    @model_validator(mode="after")
    def _a_success_was_right_before(self) -> Self:
        if self.success and (self.before not in self.truth or self.after in self.truth):
            raise ValueError(
                f"{self.mesh}, {self.attack}: a success, although the network said {self.before!r}, then "
                f"{self.after!r}, and right is {', '.join(self.truth)}"
            )
        return self

    @property
    def right(self) -> bool:
        """Whether the network was right before the attack."""
        return self.before in self.truth

    @property
    def success(self) -> bool:
        """Whether the attack succeeded: right before, wrong afterwards, verified."""
        return self.outcome == SUCCESS and self.verified

    @property
    def share(self) -> float | None:
        """The share of the image that objects cover."""
        return None if self.covered is None or not self.pixels else self.covered / self.pixels

    def case(self) -> Case:
        """The job as a case of a campaign's table."""
        return Case(
            target=self.target,
            attack=self.attack,
            state=self.state,
            right=self.right,
            outcome=self.outcome,
            success=self.success,
            loop_success=self.right and self.fooled,
            perceptibility=self.p,
            loop_perceptibility=self.p_loop,
            truncated=self.truncated,
            second_opinion=self.second_opinion,
            queries=self.queries,
            seconds=self.seconds,
        )


class Views(_Record):
    """The views that one network was asked about, as drawn by one renderer in one size."""

    target: str
    renderer: str
    size: tuple[int, int]
    asked: int
    right: int
    chosen: int
    meshes: int
    """Different meshes among the chosen views."""
    least_confidence: float | None
    """Confidence of the least confident chosen view."""


class Record(_Record):
    """A campaign that has been run."""

    command: str
    campaign: dict[str, Any]
    """The request, with every default."""
    machine: str
    versions: dict[str, str]
    backends: tuple[str, ...]
    weights: dict[str, str]
    """SHA-256 of each network's weights."""
    credits: tuple[str, ...]
    """Creators of the models and maps shown, without repetition."""
    views: tuple[Views, ...]
    jobs: tuple[Job, ...]
    curves: tuple[MeanCurves, ...]

    def table(self) -> Table:
        """The table of these jobs."""
        cells = [(job.target, job.attack) for job in self.jobs]
        return table(str(self.campaign["name"]), cells, [job.case() for job in self.jobs])


def load(path: Path) -> Record:
    """Reads a record. Raises pydantic's ValidationError, also for a success whose scene was wrong before."""
    return Record.model_validate_json(path.read_bytes())


def save(record: Record, path: Path) -> None:
    """Writes a record as JSON with a line for each job, so that a difference of two records can be read."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(rows_as_json(record.model_dump(mode="json", exclude_defaults=True)), "utf-8")
