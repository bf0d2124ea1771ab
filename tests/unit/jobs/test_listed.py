from typing import Any

import pytest

from scene_attack_service.jobs.models import LONGEST_TEXT, listed
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.records import SPEC, add, attacks

ASKED: dict[str, Any] = SPEC.model_dump(mode="json") | {
    "target": {"name": "iep", "ask": {"question": "How many cubes are there?"}}
}


@pytest.mark.questions
def test_what_a_list_shows_of_a_request() -> None:
    columns = listed(ASKED)
    assert columns["name"] == columns["asked"] == "How many cubes are there?"
    assert (columns["scene"], columns["target"]) == ("sphere", "iep")
    attack = ASKED["attack"]
    assert columns["attack"] == f"{columns['renderer']} combined {columns['method']}"
    assert (columns["renderer"], columns["method"]) == (attack["renderer"], attack["method"])
    assert listed(SPEC.model_dump(mode="json"))["asked"] is None


def test_a_scene_of_many_meshes_is_cut() -> None:
    spec = ASKED | {"scene": {"objects": [{"mesh": "primitive/sphere"}] * 100}}
    scene = listed(spec)["scene"]
    assert scene is not None
    assert len(scene) == LONGEST_TEXT
    assert scene.startswith("sphere, sphere")
    assert scene.endswith("…")


def test_lists_read_neither_request_nor_result(record: Record) -> None:
    add(record)
    [job] = attacks(record)
    assert (job.name, job.seed) == ("sphere", 7)
    for column in ("spec", "result"):
        with pytest.raises(AttributeError):
            getattr(job, column)
