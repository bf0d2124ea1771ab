"""What is said of a request's invalid fields: which field, what was given, what would be valid."""

import copy
import json
from typing import Any

import pytest

from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.spec import parse

OBJECT = {"mesh": "primitive/sphere"}


def errors(data: Any) -> list[InvalidRequest]:
    with pytest.raises(InvalidFields) as refused:
        parse(data)
    return list(refused.value.every)


def spec(path: str, value: Any) -> dict[str, Any]:
    data: dict[str, Any] = {"scene": {"objects": [copy.deepcopy(OBJECT)]}}
    *parents, last = path.split(".")
    at: Any = data
    for part in parents:
        at = at[int(part)] if part.isdigit() else at.setdefault(part, {})
    at[last] = value
    return data


MISTAKES: dict[str, tuple[Any, str]] = {
    "tolerance": ("Exact", 'must be a number from 1e-06 to 0.1 or "exact", not "Exact": largest error of a displayed'),
    "scene.lights.environment.size": (
        "Auto",
        'must be a list of 2 (an integer from 1 to 64, an integer from 1 to 128) or "auto", not "Auto": rows',
    ),
    "scene.camera.elevation": (20, "must be a number from -π/2 to π/2, not 20: angle above the horizon, radians"),
    "scene.camera.azimuth": (360, "must be a number from -2π to 2π, not 360: angle about +y"),
    "scene.camera.viewer": ("Distant", 'must be one of "distant", "perspective", not "Distant": viewer'),
    "scene.camera.size": ([224], "must be a list of 2, each an integer from 1 to 2048, not [224]: height and width"),
    "scene.camera.fov": (
        1,
        "there is no such field; there are azimuth, elevation, distance, roll, field_of_view, far, size",
    ),
    "scene.objects.0.color": ([1, 0, 0, 1], "must be a list of 3, each a number from 0 to 1, not [1, 0, 0, 1]: linear"),
    "scene.objects.0.translation": ([0, 0], "must be a list of 3, each a number from -100 to 100, not [0, 0]: posit"),
    "scene.lights.points": ({"energy": 3}, "must be a list of at most 4, each an object with the fields energy, posi"),
    "scene.ground": ("grey", 'must be a list of 3, each a number from 0 to 1, not "grey": displayed colour'),
    "goal.leave": (
        1.5,
        "must be a text of 1 to 300 characters, an integer of at least 0, a list of at most 1000, each a text of 1 to "
        "300 characters or an integer of at least 0 or null, not 1.5: the label, or all labels",
    ),
    "attack": ("fgsm", 'must be an object, in which "method" is one of apgd, cma-es, fgsm, '),
    "attack.method": ("FGSM", "there is no 'FGSM'; there are apgd, cma-es, fgsm, mi-fgsm, "),
    "attack.renderer": ("Torch", f"there is no 'Torch'; there are {', '.join(RENDERERS)}; did you mean 'torch'?"),
    "attack.truncation": (0.07, "must be an integer from 1 to 255 or null, not 0.07: U: largest change of an RGB"),
    "attack.momentum": (1, "must be a number of at least 0 and below 1, not 1: momentum"),
    "attack.seconds": (0, "must be a number above 0 and at most 86400 or null, not 0: limit of run time in seconds"),
    "attack.learning_rate": (0.1, "must be an object in which each value is a number from 0 to 1000, not 0.1: step"),
    "target": ("mine", 'must be an object with the fields name, ask, not "mine"'),
    "sceen": (
        {},
        "there is no such field; there are scene, target, goal, attack, tolerance, analysis, seed; did you mean 'scen",
    ),
}


@pytest.mark.parametrize("field", MISTAKES)
def test_a_mistake_is_named_once_with_what_is_valid(field: str) -> None:
    value, said = MISTAKES[field]
    (error,) = errors(spec(field, value))
    assert error.field == field
    assert error.detail.startswith(said)


def test_the_element_of_a_list_is_named_and_not_the_lists_around_it() -> None:
    (error,) = errors(spec("scene.objects", [OBJECT | {"color": [255, 0, 0]}]))
    assert error.field == "scene.objects.0.color.0"
    assert error.detail == "must be a number from 0 to 1, not 255: linear RGB factor on the mesh's own colours"


@pytest.mark.parametrize("size", [[16], [16, 32, 3], 16, None, {}])
def test_a_field_with_alternatives_says_all_of_them_whatever_was_given(size: object) -> None:
    (error,) = errors(spec("scene.lights.environment.size", size))
    assert error.field == "scene.lights.environment.size"
    assert 'or "auto"' in error.detail
    assert ("an object" if size == {} else json.dumps(size)) in error.detail


def test_an_alternative_with_invalid_elements_is_the_one_that_was_meant() -> None:
    found = errors(spec("scene.lights.environment.size", [128, 32]))
    assert [error.field for error in found] == ["scene.lights.environment.size.0"]
    found = errors(spec("attack", {"method": "zoo", "delta": {"normals": "small"}}))
    assert [error.field for error in found] == ["attack.delta.normals"]


def test_what_is_missing_is_said_with_what_it_must_be() -> None:
    (error,) = errors({"scene": {}})
    assert error.field == "scene.objects"
    assert error.detail.startswith("must be a list of 1 to 16, each an object with the fields mesh")
    assert error.detail.endswith("but is missing")


def test_an_object_whose_keys_have_no_list_comes_with_an_example() -> None:
    (error,) = errors(spec("attack.bounds", "from -0.5 to 0.5"))
    assert error.detail.endswith('in the group\'s units; for example {"lamp": [-0.5, 0.5]}')


def test_a_long_value_is_shortened_and_a_number_that_is_none_is_shown() -> None:
    (error,) = errors(spec("scene.camera.viewer", "x" * 10_000))
    assert "x" * 50 in error.detail
    assert len(error.detail) < 300
    (error,) = errors(spec("scene.camera.azimuth", float("nan")))
    assert "not NaN" in error.detail


def test_something_that_is_no_object_is_the_bodys_mistake() -> None:
    (error,) = errors([])
    assert error.field == "body"
    assert error.detail.startswith("must be an object with the fields scene, target, goal, attack")


def test_a_parsed_file_is_told_all_its_mistakes() -> None:
    with pytest.raises(
        InvalidRequest, match=r"must be an integer from 0 .*; colour: there is no such field"
    ) as refused:
        parse({"scene": {"objects": [OBJECT]}, "seed": -1, "colour": "blue"})
    assert refused.value.field == "seed"


@pytest.mark.parametrize(("field", "value"), [("target.name", "\ud800"), ("\ud800", 1), ("goal.truth", ["\ud800"])])
def test_text_that_is_no_unicode_is_named_in_text_that_is(field: str, value: object) -> None:
    for error in errors(spec(field, value)):
        assert "\\ud800" in f"{error.field} {error.detail}"
        str(error).encode()


@pytest.mark.parametrize("label", [True, 1.0])
def test_a_label_is_no_other_kind_of_number(label: object) -> None:
    [error] = errors(spec("goal.truth", label))
    assert error.field == "goal.truth"
    assert "integer" in error.detail
