"""The study of physical changes: its rows are what its jobs say."""

import json
from pathlib import Path

import pytest

from benchmarks.study import physical
from benchmarks.study.pages import PHYSICAL
from benchmarks.study.record import load
from benchmarks.study.tables import SETTING
from scene_attack.analysis.verdict import wilson
from scene_attack.runs.campaign_spec import parse
from tests.unit.docs.study.test_study_records import SMALL, raw, rows_of, with_jobs, won

EXAMPLES = Path(__file__).parents[4] / "examples"


def test_a_row_counts_the_verified_successes_of_its_jobs() -> None:
    jobs = raw(SMALL / "physical.json")
    rows = {row[-6]: row for row in rows_of(physical.changes([load(SMALL / "physical.json")]))}
    assert rows["paper: normals"][-5:] == ["233", "88.4", "", "9.3", ""]
    assert "paper: image" not in rows  # no change of a scene
    assert "bump, 0.2" not in rows  # has a table of its own
    for attack in ("normals", "bump"):
        own = [job for job in jobs if job["attack"] == attack]
        good = [job for job in own if won(job)]
        low, high = wilson(len(good), len(own))
        p = f"{1000 * sum(job['p'] for job in good) / len(good):.1f}" if good else "–"
        expected = [str(len(own)), f"**{100 * len(good) / len(own):.1f}**", f"{100 * low:.1f}–{100 * high:.1f}", p]
        assert rows[attack][-5:-1] == expected


def test_views_are_counted_by_the_share_that_the_object_covers(tmp_path: Path) -> None:
    """A view lies in the range whose lower edge it reaches."""
    jobs = [
        job | {"covered": covered, "pixels": 1000}
        for job, covered in zip(raw(SMALL / "physical.json"), [100, 149, 150, 999] * 4, strict=False)
        if job["attack"] == "normals"
    ]
    rows = [row[1:] for row in rows_of(physical.by_coverage([with_jobs("physical", jobs, tmp_path)]))]
    counts = dict.fromkeys(("below 10 %", "10–15 %", "15–20 %", "20 % and more"), 0)
    for job in jobs:
        share = job["covered"] / 1000
        counts[next(name for end, name in zip((0.1, 0.15, 0.2, 2), counts, strict=True) if share < end)] += 1
    assert all(map(won, jobs))
    assert rows == [[name, f"{count} of {count}" if count else "–"] for name, count in counts.items()]


def test_wavelengths_are_compared_on_the_views_that_all_of_them_attacked(tmp_path: Path) -> None:
    """Views at 1.0 rad have no job with the longer wave: a success there counts in neither row."""
    jobs = raw(SMALL / "physical.json")
    shared = {job["scene"] for job in jobs if job["attack"] == "bump, 0.2"}
    text = physical.by_wavelength(load(SMALL / "physical.json"))
    assert [row[1:3] for row in rows_of(text)] == [
        ["0.1", str(len(shared))],
        ["0.2", str(len(shared))],
    ]
    model = next(job for job in jobs if won(job))
    other = [
        job | {name: model[name] for name in ("before", "after", "truth", "outcome", "verified", "p", "step")}
        if job["attack"] == "bump" and job["scene"] not in shared
        else job
        for job in jobs
    ]
    assert other != jobs
    assert physical.by_wavelength(with_jobs("physical", other, tmp_path)) == text
    of_another = [job | {"target": "alexnet-furniture"} for job in jobs if job["attack"] == "bump"]
    assert physical.by_wavelength(with_jobs("physical", [*jobs, *of_another], tmp_path)) == text


def test_objects_are_counted_by_the_share_of_their_right_views(tmp_path: Path) -> None:
    """Of four views the network has two right: both fooled are all of them, and one is half."""
    dented = [job for job in raw(SMALL / "around.json") if job["attack"] == "bump"]
    jobs = [job | {"around": {"views": 4, "right": 2, "fooled": number}} for number, job in enumerate(dented, 1)]
    rows = rows_of(physical.around(with_jobs("around", jobs, tmp_path)))
    assert [row[-1].partition(" · ")[0] for row in rows] == [
        "2 of 2",  # the wardrobe, which covers more of the image
        "1 of 2",
        "2 of 2",  # at least 25 %
        "2 of 2",  # at least 50 %
        "1 of 2",  # at least 75 %
        "1 of 2",  # all
    ]


def test_a_view_that_was_wrong_already_is_no_view_that_was_fooled(tmp_path: Path) -> None:
    jobs = [job | {"around": {"views": 4, "right": 0, "fooled": 0}} for job in raw(SMALL / "around.json")]
    rows = rows_of(physical.around(with_jobs("around", jobs, tmp_path)))[-len(physical.SHARES) :]
    assert {cell for row in rows for cell in row[-2:]} == {"0 of 2"}


def test_the_page_has_every_part_and_says_the_changes_in_words() -> None:
    text = PHYSICAL.files(SMALL)["physical.md"]
    assert "{{" not in text
    assert "surface of " in text
    assert "`scene-attack campaign run examples/paper-around.json --out out/paper-around`" in text


@pytest.mark.parametrize("name", ["paper-physical", "paper-physical-lite0", "paper-pose", "paper-around"])
def test_what_the_page_says_of_a_campaign_is_so(name: str) -> None:
    spec = parse(json.loads((EXAMPLES / f"{name}.json").read_text("utf-8")))
    for grid in spec.grids:
        assert grid.scenes.material == "plastic"
        for column in grid.attacks:
            attack = column.attack
            assert (attack.method, attack.truncation) == ("fgsm", None)
            assert attack.steps == (15 if column.name == "pose" else 120)
            if name == "paper-around":
                assert attack.expectation is not None
                assert (attack.expectation.azimuth, attack.expectation.checks) == (180, 16)
                assert (attack.expectation.samples == 0) == column.name.endswith("one view")
            elif SETTING in column.name:
                assert attack.wavelength == float(column.name.partition(SETTING)[2])
