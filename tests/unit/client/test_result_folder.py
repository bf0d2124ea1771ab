"""A folder of one job's files is not taken by another job, and is by the same one."""

import json
from pathlib import Path
from typing import Any

import pytest

from scene_attack.cli.result_folder import check_free
from scene_attack.errors import InvalidRequest
from scene_attack.runs.spec import parse

SPHERE: dict[str, Any] = {"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "seed": 1}
FILLED_IN = {"truth": ["ball"], "leave": "ball"}


def stored(folder: Path, spec: dict[str, Any], name: str = "result.json") -> None:
    full = parse(spec).model_dump(mode="json")
    (folder / name).write_text(json.dumps({"spec": full} if name == "result.json" else full))


@pytest.mark.parametrize("name", ["result.json", "checkpoint.json"])
@pytest.mark.parametrize(
    "other",
    [{"seed": 2}, {"attack": {"steps": 7}}, {"goal": {"reach": "teapot"}}, {"goal": {"least_confidence": 0.5}}],
)
def test_another_job_is_refused(tmp_path: Path, name: str, other: dict[str, Any]) -> None:
    stored(tmp_path, SPHERE, name)
    with pytest.raises(InvalidRequest, match=r"of another job \(sphere, .*name another folder") as error:
        check_free(tmp_path, parse(SPHERE | other))
    assert error.value.field == "--out"


@pytest.mark.parametrize("goal", [{}, {"truth": ["ball"]}, {"leave": "ball"}, {"truth": [3]}])
def test_the_same_job_is_taken_though_its_goal_was_filled_in(tmp_path: Path, goal: dict[str, Any]) -> None:
    check_free(tmp_path, parse(SPHERE))
    stored(tmp_path, SPHERE | {"goal": FILLED_IN})
    check_free(tmp_path, parse(SPHERE | {"goal": goal}))


def test_a_goal_of_other_labels_is_another_job(tmp_path: Path) -> None:
    stored(tmp_path, SPHERE | {"goal": FILLED_IN})
    with pytest.raises(InvalidRequest):
        check_free(tmp_path, parse(SPHERE | {"goal": {"truth": ["cup"]}}))


def test_a_file_that_is_no_result_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("my notes")
    with pytest.raises(InvalidRequest, match=r"holds a result\.json that is no job's"):
        check_free(tmp_path, parse(SPHERE))


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InvalidRequest, match="is a file; name a folder") as refused:
        check_free(tmp_path / "file", parse(SPHERE))
    assert refused.value.field == "--out"
