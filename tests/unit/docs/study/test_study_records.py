"""Records of the study: made of real results, and without a success whose scene was wrong before."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from benchmarks.study.examples import median_success
from benchmarks.study.pages import FOLDER, NAMES
from benchmarks.study.record import Job, Record, load, save
from benchmarks.study.recording import of_folder
from scene_attack.runs.campaign_plan import views, write
from scene_attack.runs.campaign_run import first_answer, run_campaign
from scene_attack.runs.campaign_spec import parse
from tests.unit.jobs.small import LIBRARY

pytestmark = pytest.mark.slow

SMALL = Path(__file__).with_name("records")
"""Records of small campaigns that have been run."""
RECORDS = [path for folder in (SMALL, FOLDER) for name in NAMES if (path := folder / f"{name}.json").exists()]


def raw(path: Path) -> list[dict[str, Any]]:
    """The jobs of a record as they are in the file."""
    return list(json.loads(path.read_text("utf-8"))["jobs"])


def with_jobs(name: str, jobs: list[dict[str, Any]], folder: Path) -> Record:
    """The small record of a campaign with other jobs, by way of a file in `folder`."""
    whole = json.loads((SMALL / f"{name}.json").read_text("utf-8")) | {"jobs": jobs}
    (folder / f"{name}.json").write_text(json.dumps(whole), "utf-8")
    return load(folder / f"{name}.json")


def rows_of(table: str) -> list[list[str]]:
    """The cells of a Markdown table below its head, with plain spaces."""
    lines = table.replace("\u00a0", " ").splitlines()[2:]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def won(job: dict[str, Any]) -> bool:
    return job.get("outcome") == "fooled" and bool(job.get("verified"))


def test_there_is_a_small_record_of_each_campaign() -> None:
    assert {path.stem for path in SMALL.glob("*.json")} >= set(NAMES)
    assert any(won(job) for path in RECORDS for job in raw(path))


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_no_counted_success_was_wrong_before(path: Path) -> None:
    """Counted from the file's own words: the network's answers and the truth."""
    jobs = raw(path)
    for job in jobs:
        if won(job):
            assert job["before"] in job["truth"]
            assert job["after"] not in job["truth"]
    table = load(path).table()
    for cell in table.cells:
        own = [job for job in jobs if (job["target"], job["attack"]) == (cell.target, cell.attack)]
        right = [job for job in own if job["before"] in job["truth"]]
        assert cell.success.of == len(right)
        assert cell.success.count == sum(won(job) for job in right)
        assert cell.loop_success.count == sum(job.get("fooled", False) for job in right)


@pytest.mark.parametrize("change", [{"before": "something else"}, {"truth": ["something else"]}, {"after": None}])
def test_a_record_with_such_a_success_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    [path] = [path for path in RECORDS if path.parent == SMALL and path.stem == "differentiable"]
    whole = json.loads(path.read_text("utf-8"))
    job = next(job for job in whole["jobs"] if won(job))
    job |= {"after": job["truth"][0]} if "after" in change else change
    (tmp_path / "changed.json").write_text(json.dumps(whole), "utf-8")
    with pytest.raises(ValidationError, match="a success, although the network said"):
        load(tmp_path / "changed.json")


def test_a_campaigns_folder_becomes_a_record_that_says_the_same(tmp_path: Path) -> None:
    grid: dict[str, Any] = {
        "scenes": {"meshes": ["primitive/sphere"], "views": [0.61], "camera": {"size": [64, 64]}},
        "attacks": [
            {"name": "image", "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 8}},
            {"name": "colour", "attack": {"renderer": "pyrender", "groups": ["color"], "steps": 2}},
        ],
    }
    label = first_answer(views(parse({"grids": [grid]}))[0], LIBRARY).label
    found = run_campaign(parse({"name": "s", "grids": [grid | {"goal": {"truth": label}}]}), tmp_path, LIBRARY)
    write(found, tmp_path)
    made = of_folder(tmp_path)
    save(made, tmp_path / "record.json")
    again = load(tmp_path / "record.json")
    assert again == made
    for ours, theirs in zip(again.table().cells, found.table.cells, strict=True):
        assert (ours.success, ours.loop_success) == (theirs.success, theirs.loop_success)
        assert ours.outcomes == theirs.outcomes
        assert (ours.perceptibility is None) == (theirs.perceptibility is None)
        if theirs.perceptibility is not None:
            assert ours.perceptibility == pytest.approx(theirs.perceptibility, rel=1e-4)  # five digits are kept
        assert (ours.truncated, ours.by_queries) == (theirs.truncated, theirs.by_queries)
    assert again.table().cells[0].success.count == 1
    [asked] = again.views
    assert (asked.asked, asked.right, asked.chosen, asked.meshes, asked.size) == (1, 1, 1, 1, (64, 64))
    job = json.loads((tmp_path / "jobs.json").read_text("utf-8"))[0]
    (tmp_path / "jobs" / job / "result.json").unlink()
    with pytest.raises(ValueError, match="has not ended"):
        of_folder(tmp_path)


def job(p: float, request: str, **others: Any) -> Job:
    """A success with this p."""
    about = {"target": "t", "attack": "a", "mesh": "m", "azimuth": 0.0, "seed": 0, "truth": ("x",), "before": "x"}
    came = {"before_confidence": 1.0, "after": "y", "outcome": "fooled", "verified": True, "p": p, "request": request}
    return Job.model_validate(about | came | others)


def test_the_example_of_a_column_is_the_success_with_the_median_p() -> None:
    jobs = [job(0.3, "c"), job(0.1, "a"), job(0.2, "b"), job(0.15, "d", outcome="held")]
    found = median_success(jobs)
    assert found is not None
    assert found.request == "b"
    even = median_success([*jobs, job(0.25, "e")])
    assert even is not None
    assert even.request == "b"  # the lower one of the two
    assert median_success(jobs[3:]) is None


def test_a_failed_job_is_a_case_without_success() -> None:
    [path] = [path for path in RECORDS if path.parent == SMALL and path.stem == "differentiable"]
    record = load(path)
    first = record.jobs[0]
    failed = Job(**{name: getattr(first, name) for name in ABOUT}, state="failed")
    cell = Record(**{**dict(record), "jobs": (*record.jobs, failed)}).table().cell(first.target, first.attack)
    before = record.table().cell(first.target, first.attack)
    assert cell is not None
    assert before is not None
    assert (cell.success.of, cell.success.count) == (before.success.of + 1, before.success.count)


ABOUT = ("target", "attack", "mesh", "azimuth", "seed", "truth", "before", "before_confidence", "request")
