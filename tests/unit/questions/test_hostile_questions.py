"""Requests with questions made to break what reads them: refused by the field, at once and in little memory."""

import copy
from collections.abc import Callable
from typing import Any

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.runs.campaign_spec import parse as parse_campaign
from scene_attack.runs.spec import parse
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import SceneRecord

RECORD = generate(8, 2, objects=(4, 4)).model_dump(mode="json", by_alias=True)
MANY = 60_000
"""Items of a list that takes a tenth of the largest body."""


def put(*path: Any) -> Callable[[dict[str, Any]], None]:
    """Puts the last of the arguments at the place that the others name."""
    *parents, last, value = path

    def change(record: dict[str, Any]) -> None:
        at: Any = record
        for part in parents:
            at = at[part]
        at[last] = value

    return change


def nested(depth: int) -> list[Any]:
    found: list[Any] = []
    for _ in range(depth):
        found = [found]
    return found


def of(record: dict[str, Any]) -> dict[str, Any]:
    return {"source": {"format": "clevr", "record": record}}


OF = "scene.source.record"
RECORDS: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "camera above the origin": (put("camera", {"position": [0, 0, 10]}), f"{OF}.camera.position"),
    "camera at the origin": (put("camera", {"position": [0, 0, 0]}), f"{OF}.camera.position"),
    "camera at the smallest distance": (
        put("camera", {"position": [1e-320, 0, 0]}),
        f"{OF}.camera.position",
    ),
    "camera too far": (put("camera", {"position": [75, -65, 53]}), f"{OF}.camera.position"),
    "camera out of this world": (put("camera", {"position": [1e308, 1e308, 1e308]}), f"{OF}.objects.0"),
    "lights too far": (
        put("lights", {name: [1000, 0, 0] for name in ("key", "fill", "back")}),
        f"{OF}.lights",
    ),
    "lone surrogate": (put("split", "\ud800"), OF),
    "lone surrogate in a field of others": (put("objects", 0, "mask", "\ud800"), OF),
    "field of others nested too deep": (put("mask", nested(300)), OF),
    "coordinates that overflow": (
        put("objects", 0, "3d_coords", [1e308, -1e308, 0.7]),
        f"{OF}.objects.0",
    ),
    "coordinate that is no number": (
        put("objects", 0, "3d_coords", 0, float("nan")),
        f"{OF}.objects.0.3d_coords.0",
    ),
    "turn that is infinite": (put("objects", 0, "rotation", float("inf")), f"{OF}.objects.0.rotation"),
    "negative index": (put("relationships", "left", 0, [-1]), f"{OF}.relationships.left"),
    "index too large": (put("relationships", "left", 0, [10**400]), f"{OF}.relationships.left"),
    "too few rows": (put("relationships", "left", [[]]), f"{OF}.relationships.left"),
    "directions of no length": (put("directions", "left", [0, 0, 0]), f"{OF}.directions.left"),
}


@pytest.mark.parametrize(("change", "field"), RECORDS.values(), ids=RECORDS)
def test_records_are_refused_by_their_field(change: Callable[[dict[str, Any]], None], field: str) -> None:
    record = copy.deepcopy(RECORD)
    change(record)
    with pytest.raises(InvalidRequest) as refused:
        parse({"scene": of(record)})
    assert refused.value.field == field
    with pytest.raises(InvalidRequest) as refused:
        parse_campaign({"jobs": [{"scene": of(record)}]})
    assert refused.value.field == f"jobs.0.{field}"


LONG: dict[str, dict[str, Any]] = {
    "indices of no objects": {"changed": {"relationships": {"left": [["x"] * MANY]}}},
    "rows of no objects": {"changed": {"relationships": {"left": [["x"]] * MANY}}},
    "the same object again and again": {"changed": {"relationships": {"left": [[1] * MANY, [], [], []]}}},
    "objects without anything": {"changed": {"objects": [{}] * MANY}},
    "functions that are numbers": {"target": {"name": "iep", "ask": {"question": [1] * MANY}}},
    "functions in questions": {"target": {"name": "iep", "ask": {"questions": [[1] * MANY]}}},
    "unknown fields": {f"field{k}": 1 for k in range(MANY)},
}


@pytest.mark.timeout(120)  # a second is enough; comparing each error with each took six minutes
@pytest.mark.parametrize("data", LONG.values(), ids=LONG)
def test_long_lists_of_nonsense_are_refused_at_once_and_briefly(data: dict[str, Any]) -> None:
    record = data.get("changed", {})
    relations = RECORD["relationships"] | record.get("relationships", {})
    others = {name: value for name, value in data.items() if name != "changed"}
    whole = others | {"scene": of(RECORD | record | {"relationships": relations})}
    with pytest.raises(InvalidRequest) as refused:
        parse(whole)
    assert len(str(refused.value)) < 150_000


def test_a_kind_of_questions_is_named_whatever_it_is_called() -> None:
    made = {"images": 1, "kinds": ["zero_hop", "a: b"]}
    grid = {"targets": ["iep"], "generate": made, "attacks": [{"name": "a", "attack": {}}]}
    with pytest.raises(InvalidRequest, match="no kind 'a: b'") as refused:
        parse_campaign({"grids": [grid]})
    assert refused.value.field == "grids.0.generate.kinds.1"


def test_a_truth_value_is_asked_for_in_words() -> None:
    with pytest.raises(InvalidRequest, match="must be true or false, not null") as refused:
        parse({"scene": of(RECORD), "target": {"name": "iep", "ask": {"leave_kind": None}}})
    assert refused.value.field == "target.ask.leave_kind"


@pytest.mark.parametrize(("size", "refused"), [((240, 180), True), ((120, 160), False), ((180, 240), False)])
def test_an_image_of_other_proportions_has_another_frame(size: tuple[int, int], refused: bool) -> None:
    """Of the 240×180 middle pixels of a scene an object may be outside that is inside its frame."""
    scene = describe(SceneRecord.model_validate(RECORD), size).model_dump(mode="json")
    spec = parse({"scene": scene | of(RECORD)})
    source = spec.scene.source
    assert source is not None
    if not refused:
        source.check(spec.scene)
        return
    with pytest.raises(InvalidRequest) as said:
        source.check(spec.scene)
    assert said.value.field == "scene.camera.size"
