"""Which views of a campaign are attacked, and why others are not."""

from typing import Any

from scene_attack.runs.campaign_plan import ChosenView, FirstAnswer, choose, nothing_chosen, views
from scene_attack.runs.campaign_spec import parse

MESHES = ["primitive/sphere", "primitive/cube", "primitive/cone"]
TRUTH = {"primitive/sphere": ["ball"], "primitive/cube": ["ball"], "primitive/cone": ["cone", "hat"]}
SAID = [
    ("ball", 0.9),
    ("ball", 0.7),
    ("hat", 0.6),
    ("ball", 0.8),
    ("box", 0.99),
    ("cone", 0.6),
]
"""Answers to the sphere, the cube and the cone, then to the three again."""


def chosen(selection: dict[str, Any], **changed: Any) -> list[ChosenView]:
    """The choice among the six views, with these rules."""
    grid = {
        "scenes": {"meshes": MESHES, "views": [0.1, 0.2]},
        "attacks": [{"name": "image", "attack": {"renderer": "image"}}],
        "selection": selection,
    }
    found = views(parse({"grids": [grid]}))
    answers = {}
    for view, (label, confidence) in zip(found, SAID, strict=True):
        truth = TRUTH[view.probe.scene.objects[0].mesh]
        answers[view.number] = FirstAnswer(view=view.number, label=label, confidence=confidence, truth=truth)
    for number, answer in changed.get("answers", {}).items():
        answers[number] = answer
    return choose(found, answers)


def numbers(found: list[ChosenView]) -> list[int]:
    return [view.number for view in found if view.chosen]


def test_only_right_views_are_attacked() -> None:
    found = chosen({})
    assert numbers(found) == [0, 1, 2, 3, 5]
    assert found[4].why == "the network says box, which is wrong"
    assert not found[4].right
    assert numbers(chosen({"right": False})) == [0, 1, 2, 3, 4, 5]


def test_the_most_confident_are_taken() -> None:
    found = chosen({"most": 2})
    assert numbers(found) == [0, 3]
    assert found[1].why == "there are 2 more confident views"
    assert numbers(chosen({"most": 3, "right": False})) == [0, 3, 4]


def test_of_each_class_and_of_each_mesh() -> None:
    # the sphere and the cube are of one class; of equally confident views the earlier one is taken
    assert numbers(chosen({"per_class": 1})) == [0, 2]
    assert numbers(chosen({"per_class": 2})) == [0, 2, 3, 5]
    assert numbers(chosen({"per_mesh": 1})) == [0, 1, 2]
    # a view that its mesh has no place for takes none of its class's
    assert numbers(chosen({"per_mesh": 1, "per_class": 2})) == [0, 1, 2]
    assert numbers(chosen({"per_mesh": 1, "per_class": 2, "most": 2})) == [0, 1]
    assert chosen({"per_mesh": 1})[3].why == "there is a more confident view of its mesh"


def test_the_network_must_be_sure() -> None:
    assert numbers(chosen({"least_confidence": 0.75})) == [0, 3]


def test_views_that_cannot_be_judged_are_not_attacked() -> None:
    refused = FirstAnswer(view=0, refused="scene.objects.0: it is out of view")
    unknown = FirstAnswer(view=1, label="ball", confidence=1.0)
    found = chosen({}, answers={0: refused, 1: unknown})
    assert numbers(found) == [2, 3, 5]
    assert [view.why for view in found[:2]] == ["scene.objects.0: it is out of view", "nobody knows its truth"]
    assert numbers(chosen({"right": False}, answers={0: refused, 1: unknown})) == [1, 2, 3, 4, 5]


def test_targets_are_chosen_for_each_on_its_own() -> None:
    grid = {
        "scenes": {"meshes": MESHES[:1], "views": [0.1, 0.2]},
        "targets": ["one", "two"],
        "attacks": [{"name": "image", "attack": {"renderer": "image"}}],
        "selection": {"most": 1},
    }
    found = views(parse({"grids": [grid, grid]}))
    answers = {
        view.number: FirstAnswer(view=view.number, label="ball", confidence=0.1 * view.number, truth=["ball"])
        for view in found
    }
    # the views of grid 0 are 0 to 3, of target "one" the even ones
    assert numbers(choose(found, answers)) == [2, 3, 6, 7]
    assert not choose(found, {})[0].chosen


def test_shared_views_are_right_for_every_target_and_ranked_by_the_first() -> None:
    grid = {
        "scenes": {"meshes": MESHES, "views": [0.1]},
        "targets": ["one", "two"],
        "attacks": [
            {"name": "image", "attack": {"renderer": "image"}},
            {"name": "pose", "attack": {"renderer": "pyrender", "groups": ["rotation"]}},
        ],
        "selection": {"most": 1, "shared": True},
    }
    found = views(parse({"grids": [grid]}))
    # by scene, target and renderer: of the sphere 0 and 1 are of target "one", 2 and 3 of "two"
    confidences = [0.9, 0.6, 0.5, 0.6, 0.8, 0.7, 0.9, 0.6, 0.99, 0.5, 0.99, 0.5]
    answers = {
        view.number: FirstAnswer(view=view.number, label="ball", confidence=confidences[view.number], truth=["ball"])
        for view in found
    }
    wrong = FirstAnswer(view=10, label="hat", confidence=0.99, truth=["ball"])
    chosen_views = choose(found, answers | {10: wrong})
    # of the torch renderer "one" is surest of the cone, which "two" gets wrong, then of the sphere
    assert numbers(chosen_views) == [0, 2, 5, 7]
    assert chosen_views[8].why == "of two: the network says hat, which is wrong"
    assert chosen_views[10].why == "the network says hat, which is wrong"
    assert [chosen_views[n].why for n in (4, 6)] == ["there is a more confident view"] * 2


def test_a_campaign_that_attacks_nothing_says_why() -> None:
    unknown = {number: FirstAnswer(view=number, label="ball", confidence=0.9) for number in range(5)}
    said = nothing_chosen(chosen({"least_confidence": 0.95}, answers=unknown))
    assert said is not None
    assert said.startswith("No view is attacked: nobody knows its truth (5 of 6); the network is less sure than 0.95")
    assert "goal.truth" in said
    assert nothing_chosen(chosen({})) is None
    assert "goal.truth" not in (nothing_chosen(chosen({"least_confidence": 1, "right": False})) or "goal.truth")
