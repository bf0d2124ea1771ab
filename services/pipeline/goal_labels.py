"""Looks up the labels that a goal names. It needs no torch, so that a request is checked before it is queued."""

from dataclasses import dataclass

from services.attacks.attack import Goal, Label, Labels
from services.errors import InvalidFields, InvalidRequest
from services.targets.info import TargetInfo
from services.targets.labels import same_labels
from services.text import did_you_mean


@dataclass(frozen=True)
class AskedGoal:
    """A goal as the request states it, in label indices. A truth of None is one that the request leaves out."""

    goal: Goal
    labels: tuple[str, ...]
    same: tuple[frozenset[int], ...]
    """Groups of labels that mean the same."""
    truth: frozenset[int] | None
    leave: frozenset[int]
    reach: int | None


def asked(goal: Goal, target: TargetInfo, labels: tuple[str, ...]) -> AskedGoal:
    """Looks up the labels of a goal, and with each those that mean the same.

    Raises InvalidFields with every label that is not among the target's, and InvalidRequest if the label to reach is
    one to leave.
    """
    same = tuple(frozenset(labels.index(one) for one in group if one in labels) for group in same_labels(target))
    wrong: list[InvalidRequest] = []

    def index(field: str, wanted: Label) -> frozenset[int]:
        try:
            return frozenset([_index(wanted, labels, field, target.name)])
        except InvalidRequest as error:
            wrong.append(error)
            return frozenset()

    def looked_up(field: str, wanted: Labels | None) -> frozenset[int]:
        if not isinstance(wanted, tuple):
            return frozenset() if wanted is None else index(field, wanted)
        return frozenset[int]().union(*(index(f"{field}.{i}", one) for i, one in enumerate(wanted)))

    truth = None if goal.truth is None else with_same(looked_up("goal.truth", goal.truth), same)
    leave = with_same(looked_up("goal.leave", goal.leave), same)
    reached = looked_up("goal.reach", goal.reach)
    if wrong:
        raise InvalidFields(wrong)
    reach = next(iter(reached), None)
    if reach in leave:
        raise InvalidRequest("goal.reach", f"is a label to leave ({labels[reach]!r}); name another one")
    return AskedGoal(goal, labels, same, truth, leave, reach)


def with_same(labels: frozenset[int], groups: tuple[frozenset[int], ...]) -> frozenset[int]:
    """The labels, and those that mean the same as one of them."""
    return labels.union(*(group for group in groups if group & labels))


def _index(wanted: str | int, labels: tuple[str, ...], field: str, target: str) -> int:
    if isinstance(wanted, int):
        if wanted >= len(labels):
            raise InvalidRequest(field, f"{target} has labels 0 to {len(labels) - 1}, not {wanted}")
        return wanted
    if wanted not in labels:
        raise InvalidRequest(field, f"{target} has no label {wanted!r}{did_you_mean(wanted, labels)}")
    return labels.index(wanted)
