"""What costs a client nothing to send costs little to refuse, and a number is a number."""

import copy
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from scene_attack.errors import InvalidRequest
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.field_errors import invalid_fields
from scene_attack.runs.spec import JobSpec
from scene_attack.strict import MOST_FIELDS

MANY = 30_000
SCENE = {"objects": [{"mesh": "primitive/sphere"}]}
ATTACKS = [{"name": "a", "attack": {}}]


def put(path: str, value: Any) -> dict[str, Any]:
    """A good request with a value put at a path."""
    if path.startswith(("grids", "jobs")):
        data: Any = {"grids": [{"scenes": [SCENE], "attacks": ATTACKS}]}
    else:
        data = {"scene": SCENE, "attack": {"renderer": "pyrender"}}
    data = copy.deepcopy(data)
    *parents, last = path.split(".")
    at = data
    for part in parents:
        at = at[int(part)] if part.isdigit() else at.setdefault(part, {})
    at[int(last) if last.isdigit() else last] = value
    return data  # type: ignore[no-any-return]


def refused(data: dict[str, Any]) -> ValidationError:
    with pytest.raises(ValidationError) as error:
        (CampaignSpec if "grids" in data else JobSpec).model_validate(data)
    return error.value


def fields(error: ValidationError, model: type[BaseModel]) -> list[InvalidRequest]:
    return invalid_fields(error.errors(include_url=False), model)


LISTS = (
    "scene.objects",
    "scene.lights.points",
    "attack.groups",
    "goal.truth",
    "goal.leave",
    "jobs",
    "grids",
    "grids.0.scenes",
    "grids.0.scenes.meshes",
    "grids.0.scenes.views",
    "grids.0.targets",
    "grids.0.attacks",
    "grids.0.seeds",
)


@pytest.mark.parametrize("path", LISTS)
@pytest.mark.parametrize("item", [{}, None, [[]]], ids=str)
def test_items_of_a_list_over_its_limit_are_not_looked_at(path: str, item: object) -> None:
    if path == "grids.0.scenes.meshes":
        data = put("grids.0.scenes", {"meshes": [item] * MANY})
    elif path == "grids.0.scenes.views":
        data = put("grids.0.scenes", {"meshes": ["a"], "views": [item] * MANY})
    else:
        data = put(path, [item] * MANY)
    assert refused(data).error_count() <= 4  # of a field with alternatives, one each


@pytest.mark.parametrize("path", ["jobs", "grids.0.scenes", "grids.0.seeds", "goal.truth"])
def test_a_long_list_within_its_limit_ends_at_the_first_wrong_item(path: str) -> None:
    assert refused(put(path, [{}] * 900)).error_count() <= 30  # the first item has several errors


def test_of_a_short_list_each_wrong_item_is_named() -> None:
    error = refused(put("scene.objects", [{}, {"mesh": "primitive/sphere"}, {}]))
    assert [one.field for one in fields(error, JobSpec)] == ["scene.objects.0.mesh", "scene.objects.2.mesh"]


@pytest.mark.parametrize("path", ["scene", "attack", "attack.bounds", "attack.epsilon"])
def test_an_object_of_many_fields_is_refused_as_a_whole(path: str) -> None:
    error = refused(put(path, {f"field{k}": None for k in range(MANY)}))
    [said] = fields(error, JobSpec)
    assert error.error_count() <= 2
    assert (said.field, f"may have {MOST_FIELDS}" in said.detail) == (path, True)


@pytest.mark.parametrize(
    "data",
    [
        put("x" * MANY, 1),
        put("attack.method", "x" * MANY),
        put("attack.renderer", "x" * MANY),
        put("attack.groups", ["x" * MANY]),
        put("attack.epsilon", {"x" * MANY: 1}),
        put("grids.0.scenes", {"kinds": ["x" * MANY]}),
        put("grids.0.attacks", [{"name": str(k), "attack": {"x" * 1000: 1}} for k in range(64)]),
    ],
    ids=range(7),
)
def test_an_answer_is_short_whatever_was_sent(data: dict[str, Any]) -> None:
    model = CampaignSpec if "grids" in data else JobSpec
    said = fields(refused(data), model)
    assert said
    assert sum(len(str(one)) for one in said) < 100_000
    assert max(len(str(one)) for one in said) < 3_000


NUMBERS = {
    "seed": (3, ["3", True, 3.0]),
    "scene.camera.azimuth": (1, ["1", True]),
    "scene.camera.size": ([8, 8], [["8", 8], [8.0, 8], [True, 8]]),
    "scene.ground": ([0, 1, 0.5], [["0", 1, 1], [False, 1, 1]]),
    "attack.steps": (5, ["5", 5.0, True]),
    "attack.epsilon": ({"color": 1}, [{"color": "1"}, {"color": True}]),
    "attack.bounds": ({"color": [-1, 1.5]}, [{"color": ["-1", 1]}, {"color": [False, 1]}]),
    "attack.queries": (5, ["5", 5.0]),
    "tolerance": (0.01, ["0.01", True]),
    "goal.least_confidence": (0, ["0", False]),
    "grids.0.seeds": ([1, 2], [["1"], [1.0], [True]]),
    "grids.0.selection.right": (False, ["false", 0]),
}


@pytest.mark.parametrize(("path", "good", "bad"), [(path, *both) for path, both in NUMBERS.items()], ids=NUMBERS)
def test_a_text_or_a_boolean_is_no_number(path: str, good: object, bad: list[object]) -> None:
    data = put(path, good)
    model = CampaignSpec if path.startswith("grids") else JobSpec
    model.model_validate(data)
    for value in bad:
        said = fields(refused(put(path, value)), model)
        assert [one.field.startswith(path) for one in said] == [True], (value, said)
