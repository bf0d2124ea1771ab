"""Classification: the task of a network that says what it sees. The truth, the labels to leave, the label to reach."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from scene_attack.analysis.images import answer
from scene_attack.analysis.subsets import ScoredImage
from scene_attack.analysis.transfer import indices
from scene_attack.analysis.verdict import Verdict, judge
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.protocol import Parameters
from scene_attack.runs.result import FirstAnswer, warnings
from scene_attack.runs.spec import MAX_LABELS, AskedGoal, Goal, JobSpec, with_same
from scene_attack.runs.task import Settled
from scene_attack.targets import registry
from scene_attack.targets.info import TargetInfo
from scene_attack.targets.labels import truth_labels
from scene_attack.targets.protocol import Target
from scene_attack.targets.scores import probability


@dataclass(frozen=True)
class Classification:
    """A network that says what it sees, or what it was asked of which nothing but the scores is known: a `Task`."""

    target: Target
    asked: AskedGoal
    table: tuple[int, ...]
    """The labels that the reviewed table says are right for the scene (`table_truth`)."""
    question: str | None = None
    """What it was asked, in words, if it was asked something."""

    def settle(self, original: Tensor, logits: Tensor) -> Settled:  # noqa: ARG002 - other tasks need it
        """By the truth of the request, or of the table."""
        return settle(self.asked, self.table, logits)

    def constraint(self, renderer: str, initial: Parameters) -> None:
        """None: what a thing is does not depend on where it is."""

    def plan(self) -> None:
        """Nothing."""

    def first_answers(self, original: Tensor, logits: Tensor, goal: ResolvedGoal) -> tuple[FirstAnswer, ...]:  # noqa: ARG002
        """One answer."""
        return (FirstAnswer(asked=self.question, answer=answer(logits, self.target.labels, goal)),)

    def judge(
        self,
        settled: Settled,
        renderer: str,  # noqa: ARG002
        stored: Parameters,  # noqa: ARG002
        before: ScoredImage,
        after: ScoredImage,
        out: Path,  # noqa: ARG002
    ) -> tuple[Verdict, None]:
        """By the truth and the scores alone."""
        first, last = int(before.logits.argmax()), int(after.logits.argmax())
        return judge(settled.truth, first, last, bool(settled.goal.fooled(after.logits))), None


def seen(spec: JobSpec, target: Target, asked: AskedGoal, question: str | None = None) -> Classification:
    """The classification of a job's image by a target that has scores, such as one that was asked a question."""
    table = table_truth((thing.mesh for thing in spec.scene.objects), registry.card(spec.target.name), asked.labels)
    return Classification(target, asked, table, question)


def table_truth(meshes: Iterable[str], target: TargetInfo, labels: tuple[str, ...]) -> tuple[int, ...]:
    """Returns the labels that the reviewed table says are right for a scene of these meshes.

    Empty if a mesh is not in the table, or if two meshes differ in their labels: of a chair at a table either answer
    may be right, and nobody has said which.
    """
    label_sets = {truth_labels(target, mesh) for mesh in meshes}
    names = label_sets.pop() if len(label_sets) == 1 else ()
    return tuple(labels.index(name) for name in names if name in labels)


def for_another(
    names: Collection[str], of: TargetInfo, meshes: Iterable[str], target: TargetInfo, labels: tuple[str, ...]
) -> frozenset[int]:
    """The labels of `target` for what the `names` of another network, `of`, say is right: by name, or else by its own
    table.

    Names are not taken between two vocabularies of different meaning: ImageNet's "cup" is no "coffee mug", which is a
    "cup" among kinds of furniture.
    """
    meanings = {of.vocabulary, target.vocabulary} - {"custom"}
    named = indices(names, labels) if len(meanings) < 2 else frozenset()
    return named or frozenset(table_truth(meshes, target, labels))


def settle(asked: AskedGoal, table: Iterable[int], logits: Tensor) -> Settled:
    """Settles a goal, given the table's truth and the network's scores [K] of the original image.

    Raises InvalidRequest if the answer is not among the labels to leave, if it is the label to reach, if reaching that
    label would not be wrong, if no other label is left, or if truth and labels to leave are more than a goal may name.
    """
    labels, leave, reach = asked.labels, asked.leave, asked.reach
    first = int(logits.argmax())
    confidence = float(probability(logits, first))
    first_answer = f"{labels[first]!r} ({confidence:.2f})"
    if leave and first not in leave and asked.truth and first in asked.truth:
        first_answer += f", which is right and not {_words(leave, labels)}"
        raise InvalidRequest(
            "goal.leave", f"the network says {first_answer}; leave this field out to attack that answer"
        )
    if leave and first not in leave:
        raise InvalidRequest(
            "goal.leave",
            f"the network already gets this scene wrong: it says {first_answer}, not {_words(leave, labels)}; "
            "choose a view it gets right, or leave this field out to attack its own first answer",
        )
    if first == reach:
        raise InvalidRequest("goal.reach", f"the network already says {first_answer}; there is nothing to attack")
    # stated, reviewed, or implied by the label to leave
    truth = asked.truth if asked.truth is not None else with_same(frozenset(table), asked.same) or leave
    right = first in truth
    if right and reach in truth:
        raise InvalidRequest(
            "goal.reach", f"is as right as the network's answer {first_answer}; name a label that is wrong"
        )
    if right:
        leave |= truth
    elif reach is None:
        leave |= with_same(frozenset([first]), asked.same)
    if len(leave) == len(labels):
        field = "goal.leave" if asked.leave else "goal.truth"
        raise InvalidRequest(field, "these are all labels of the network; there is no other answer")
    if max(len(leave), len(truth)) > MAX_LABELS:
        detail = f"with the labels to leave, and labels that mean the same, these are more than {MAX_LABELS:,} labels"
        raise InvalidRequest("goal.truth", f"{detail}; name fewer")
    return Settled(
        _filled_in(asked, truth, leave),
        ResolvedGoal(tuple(sorted(leave)), reach, asked.goal.least_confidence),
        tuple(sorted(truth)),
        warnings(labels[first], confidence, tuple(labels[i] for i in sorted(truth)), right),
    )


def _filled_in(asked: AskedGoal, truth: frozenset[int], leave: frozenset[int]) -> Goal:
    labels = asked.labels
    names = tuple(labels[i] for i in sorted(leave))
    return asked.goal.model_copy(
        update={
            "truth": tuple(labels[i] for i in sorted(truth)),
            "leave": names[0] if len(names) == 1 else names or None,
            "reach": None if asked.reach is None else labels[asked.reach],
        }
    )


def _words(indices: frozenset[int], labels: tuple[str, ...]) -> str:
    return " or ".join(repr(labels[i]) for i in sorted(indices))
