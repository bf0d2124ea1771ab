"""The fields that questions add to requests are read as strictly as all others, and cost as little to refuse."""

import copy
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.spec import JobSpec
from scene_attack.strict import MOST_FIELDS
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import SceneRecord
from tests.unit.runs.test_strict_input import MANY, fields, refused

RECORD = generate(0, 0, objects=(3, 3)).model_dump(mode="json", by_alias=True)
JOB = {
    "scene": {"source": {"format": "clevr", "record": RECORD}},
    "target": {"name": "iep", "ask": {}},
    "attack": {"renderer": "pyrender"},
}
GRIDS = {"grids": [{"targets": ["iep"], "generate": {"images": 1}, "attacks": [{"name": "a", "attack": {}}]}]}


def put(path: str, value: Any) -> dict[str, Any]:
    """A good request with a value put at a path."""
    data: Any = copy.deepcopy(GRIDS if path.startswith("grids") else JOB)
    *parents, last = path.split(".")
    at = data
    for part in parents:
        at = at[int(part)] if part.isdigit() else at[part]
    at[int(last) if last.isdigit() else last] = value
    return data  # type: ignore[no-any-return]


@pytest.mark.parametrize("path", ["target.ask.question", "target.ask.questions", "grids.0.generate.kinds"])
@pytest.mark.parametrize("item", [{}, None, [[]]], ids=str)
def test_items_of_a_list_over_its_limit_are_not_looked_at(path: str, item: object) -> None:
    assert refused(put(path, [item] * MANY)).error_count() <= 4  # of a field with alternatives, one each


def test_an_object_of_many_fields_is_refused_as_a_whole() -> None:
    path = "scene.source.record.relationships"
    error = refused(put(path, {f"field{k}": None for k in range(MANY)}))
    [said] = fields(error, JobSpec)
    assert error.error_count() <= 2
    assert (said.field, f"may have {MOST_FIELDS}" in said.detail) == (path, True)


NUMBERS = {
    "target.ask.leave_kind": (True, ["true", 1, "yes"]),
    "grids.0.generate.leave_kind": (True, ["true", 1, "yes"]),
    "scene.source.record.image_index": (0, ["0", 0.0, False]),
    "scene.source.record.objects.0.rotation": (RECORD["objects"][0]["rotation"], ["0", True]),
    "scene.source.record.objects.0.pixel_coords": ([1, 2, 3.5], [["1", 2, 3.5], [1.0, 2, 3.5], [1, 2, "3.5"]]),
    "scene.source.record.relationships.left.0": (RECORD["relationships"]["left"][0], [["1"], [1.0], [True]]),
    "scene.source.record.directions.left": (RECORD["directions"]["left"], [["0", 1, 0], [True, 1, 0]]),
}


@pytest.mark.parametrize(("path", "good", "bad"), [(path, *both) for path, both in NUMBERS.items()], ids=NUMBERS)
def test_a_text_or_a_boolean_is_no_number(path: str, good: object, bad: list[object]) -> None:
    model: type[BaseModel] = CampaignSpec if path.startswith("grids") else JobSpec
    model.model_validate(put(path, good))
    for value in bad:
        said = fields(refused(put(path, value)), model)
        assert [one.field.startswith(path) for one in said] == [True], (value, said)


def test_files_of_scenes_are_read_as_strictly() -> None:
    SceneRecord.model_validate(RECORD | {"image_index": 7})
    with pytest.raises(ValidationError, match="valid integer"):
        SceneRecord.model_validate_json(
            SceneRecord.model_validate(RECORD)
            .model_dump_json()
            .replace(f'"image_index":{RECORD["image_index"]}', '"image_index":"7"')
        )
