"""The goal of a request as label indices, with a network of five labels of which two mean the same."""

from typing import Any

import pytest
import torch

from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.errors import InvalidRequest
from scene_attack.runs import classification, spec
from scene_attack.runs.classification import Settled
from scene_attack.runs.spec import MAX_LABELS, Goal
from scene_attack.targets.info import TargetInfo
from scene_attack.targets.labels import truth_labels
from scene_attack.targets.registry import card

LABELS = ("sunglass", "sunglasses", "mask", "loupe", "snorkel")
IMAGENET = card("efficientnet-lite0")
OTHER = IMAGENET.model_copy(update={"name": "other", "vocabulary": "custom"})


def settled(
    first: str, table: tuple[int, ...] = (), *, target: TargetInfo = IMAGENET, confidence: float = 0.9, **goal: Any
) -> Settled:
    """The goal, of a network that answers `first` with this confidence."""
    logits = torch.full((5,), (1 - confidence) / 4, dtype=torch.float64)
    logits[LABELS.index(first)] = confidence
    return classification.settle(spec.asked_goal(Goal.model_validate(goal), target, LABELS), table, logits.log())


def codes(found: Settled) -> list[str]:
    return [warning.code for warning in found.warnings]


def test_nothing_known_leaves_the_first_answer_and_what_means_the_same() -> None:
    found = settled("mask")
    assert found.goal == ResolvedGoal((2,), None)
    assert found.spec.leave == "mask"
    assert (found.truth, found.spec.truth) == ((), ())
    assert codes(found) == ["truth-unknown"]
    assert settled("sunglasses").goal.leave == (0, 1)
    assert settled("sunglasses").spec.leave == ("sunglass", "sunglasses")
    assert settled("sunglasses", target=OTHER).goal.leave == (1,), "only ImageNet's labels are known to mean the same"


def test_a_right_answer_leaves_the_whole_truth() -> None:
    for found in (settled("mask", table=(2, 3)), settled("mask", truth=["loupe", "mask"])):
        assert found.goal.leave == found.truth == (2, 3)
        assert found.spec.truth == ("mask", "loupe")
        assert codes(found) == []


def test_a_wrong_answer_is_attacked_and_warned_of() -> None:
    for found in (settled("snorkel", table=(2, 3)), settled("snorkel", truth=["loupe", "mask"])):
        assert (found.goal.leave, found.truth) == ((4,), (2, 3))
        assert codes(found) == ["already-wrong"]
        assert found.warnings[0].field == "goal.truth"
        assert "'snorkel' (0.90), not 'mask' or 'loupe'" in found.warnings[0].text


def test_a_label_to_leave_must_be_the_first_answer_and_states_the_truth_where_nothing_else_does() -> None:
    with pytest.raises(InvalidRequest, match="already gets this scene wrong") as refused:
        settled("snorkel", leave="mask")
    assert refused.value.field == "goal.leave"
    for leave in ("mask", 2, ["mask"]):
        found = settled("mask", leave=leave)
        assert (found.goal.leave, found.truth) == ((2,), (2,))
    found = settled("mask", table=(2, 3), leave="mask")
    assert (found.goal.leave, found.truth) == ((2, 3), (2, 3)), "the whole truth is left"
    found = settled("mask", table=(4,), leave="mask")
    assert (found.goal.leave, found.truth) == ((2,), (4,)), "the reviewed table is believed"
    found = settled("mask", table=(4,), leave="mask", truth="mask")
    assert (found.goal.leave, found.truth) == ((2,), (2,)), "the sender is believed most"


def test_a_right_answer_that_is_none_to_leave_is_not_called_wrong() -> None:
    with pytest.raises(InvalidRequest, match="which is right and not 'snorkel'") as refused:
        settled("mask", truth="mask", leave="snorkel")
    assert refused.value.field == "goal.leave"


def test_an_empty_truth_says_that_nobody_knows() -> None:
    found = settled("mask", table=(2, 3), truth=[])
    assert (found.goal.leave, found.truth) == ((2,), ())
    assert codes(found) == ["truth-unknown"]
    assert settled("mask", truth=[], leave="mask").truth == ()


def test_to_leave_nothing_is_no_goal() -> None:
    with pytest.raises(ValueError, match="no label to leave"):
        Goal.model_validate({"leave": []})


def test_a_targeted_goal() -> None:
    assert settled("mask", reach="snorkel").goal == ResolvedGoal((), 4)
    found = settled("mask", table=(2, 3), reach="snorkel", least_confidence=0.25)
    assert (found.goal, found.spec.reach) == (ResolvedGoal((2, 3), 4, 0.25), "snorkel")
    with pytest.raises(InvalidRequest, match="already says 'mask'") as refused:
        settled("mask", reach="mask")
    assert refused.value.field == "goal.reach"
    with pytest.raises(InvalidRequest, match="as right as the network's answer") as refused:
        settled("mask", table=(2, 3), reach="loupe")
    assert refused.value.field == "goal.reach"
    with pytest.raises(InvalidRequest, match="is a label to leave") as refused:
        settled("sunglass", leave="sunglass", reach="sunglasses")
    assert refused.value.field == "goal.reach"
    found = settled("snorkel", table=(2, 3), reach="loupe")
    assert (found.goal.reach, codes(found)) == (3, ["already-wrong"]), "a wrong network may be brought to the truth"


@pytest.mark.parametrize(
    ("goal", "field"),
    [
        ({"truth": "sun glasses"}, "goal.truth"),
        ({"truth": ["mask", "sun glasses"]}, "goal.truth.1"),
        ({"truth": 5}, "goal.truth"),
        ({"leave": ["mask", 5]}, "goal.leave.1"),
        ({"reach": 5}, "goal.reach"),
        ({"truth": list(LABELS)}, "goal.truth"),
        ({"leave": list(LABELS)}, "goal.leave"),
    ],
)
def test_a_label_that_the_network_lacks_or_all_of_them_are_refused(goal: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        settled("mask", **goal)
    assert refused.value.field == field


def test_a_goal_of_more_labels_than_a_request_may_name_is_refused() -> None:
    labels = tuple(f"label {number}" for number in range(2 * MAX_LABELS + 2))
    logits = torch.zeros(len(labels)).index_fill(0, torch.tensor(0), 9.0)
    leave, truth = labels[:MAX_LABELS], (labels[0], *labels[MAX_LABELS : 2 * MAX_LABELS - 1])
    info = IMAGENET.model_copy(update={"vocabulary": "custom"})
    with pytest.raises(InvalidRequest, match="more than 1,000 labels; name fewer") as refused:
        classification.settle(spec.asked_goal(Goal(truth=truth, leave=leave), info, labels), (), logits)
    assert refused.value.field == "goal.truth"
    classification.settle(spec.asked_goal(Goal(truth=leave, leave=leave), info, labels), (), logits)


def test_an_unsure_answer_is_warned_of() -> None:
    assert codes(settled("mask", table=(2,), confidence=0.51)) == []
    found = settled("mask", table=(2,), confidence=0.49)
    assert codes(found) == ["low-confidence"]
    assert found.warnings[0].field == "scene"


@pytest.mark.parametrize(
    ("first", "table", "goal"),
    [
        ("mask", (), {}),
        ("sunglass", (), {}),
        ("mask", (2, 3), {}),
        ("snorkel", (2, 3), {}),
        ("mask", (4,), {"leave": "mask"}),
        ("mask", (), {"leave": "mask"}),
        ("mask", (2, 3), {"reach": "snorkel"}),
        ("mask", (), {"reach": "snorkel", "least_confidence": 0.5}),
    ],
)
def test_the_goal_that_is_stored_is_the_same_goal(first: str, table: tuple[int, ...], goal: dict[str, Any]) -> None:
    """The worker settles what the check has filled in."""
    once = settled(first, table, **goal)
    again = settled(first, table, **once.spec.model_dump(mode="json"))
    assert again == once


# The table


def test_a_scene_has_the_truth_that_its_objects_share() -> None:
    labels = ("upright", "soccer ball", "grand piano")

    def truth(*meshes: str, target: TargetInfo = IMAGENET) -> tuple[int, ...]:
        return classification.table_truth([f"furniture/{mesh}" for mesh in meshes], target, labels)

    assert truth("soccer-ball") == truth("soccer-ball", "soccer-ball") == (1,)
    assert truth("soccer-ball", "grand-piano") == ()
    assert truth("soccer-ball", "chair") == (), "of the chair nobody knows"
    assert truth("chair") == truth("no-such-thing") == ()
    assert truth("soccer-ball", target=OTHER) == ()
    assert classification.table_truth(["primitive/sphere"], IMAGENET, labels) == ()
    assert classification.table_truth(["furniture/soccer-ball"], IMAGENET, ("upright",)) == (), (
        "a label that it has not"
    )


def test_for_a_network_of_kinds_the_truth_is_the_kind() -> None:
    kinds = IMAGENET.model_copy(update={"vocabulary": "furniture-14"})
    assert truth_labels(kinds, "furniture/couch") == ("sofa",)
    assert truth_labels(kinds, "furniture/no-such-thing") == ()
    assert classification.table_truth(["furniture/couch"], kinds, ("chair", "sofa")) == (1,)
    assert classification.table_truth(["furniture/couch"], kinds, ("chair", "table")) == ()
