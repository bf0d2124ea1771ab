"""The study's page: written from its records, with the paper's figures as the paper prints them."""

import json
import shutil
from pathlib import Path

import pytest

from benchmarks.study import equal_p, tables
from benchmarks.study.pages import CLASSIFICATION
from benchmarks.study.record import load
from scene_attack.runs.campaign_spec import parse
from tests.unit.docs.study.test_study_records import SMALL, job, raw, with_jobs, won

PAGE, files = CLASSIFICATION.name, CLASSIFICATION.files
TABLE_1 = {
    "AlexNet": "100.00 5.7 89.27 10.8 29.61 25.8 18.88 25.8 94.42 18.1",
    "ResNet-34": "99.57 5.1 88.41 9.3 14.16 29.3 3.43 55.2 94.85 16.4",
}
"""Rows of the paper's first table as printed: per cent, then p ×10⁻³, of each of its five columns."""


def row(page: str, first: str, second: str) -> list[str]:
    """The cells of the first table row after `first` whose second cell is `second`."""
    lines = page.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(f"| **{first}** |"))
    cells = ([cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines[start:])
    return next(found for found in cells if len(found) > 1 and second in found[:2])


def test_the_papers_row_is_the_papers() -> None:
    page = files(SMALL)[PAGE]
    for name, printed in TABLE_1.items():
        found = row(page, name, "paper")
        values = [float(value) for cell in found[3:8] for value in cell.split("\u00a0·\u00a0")]
        assert values == [pytest.approx(float(one), abs=0.05) for one in printed.split()]


def test_our_row_is_what_the_jobs_say() -> None:
    page = files(SMALL)[PAGE]
    jobs = [one for one in raw(SMALL / "differentiable.json") if one["target"] == "resnet34-furniture"]
    attacks = list(dict.fromkeys(one["attack"] for one in jobs))
    found = row(page, "ResNet-34", "**verified**")
    for attack, cell in zip(attacks, found[2:], strict=False):
        own = [one for one in jobs if one["attack"] == attack]
        good = [one for one in own if won(one)]
        p = f"{1000 * sum(one['p'] for one in good) / len(good):.1f}" if good else "–"
        assert cell == f"**{100 * len(good) / len(own):.1f}\u00a0·\u00a0{p}**"


def test_the_papers_count_has_the_p_of_the_truncated_images(tmp_path: Path) -> None:
    """Three times the p in the loop, and one more image in the loop that fooled: of the two rows one changes."""
    for path in SMALL.glob("*.json"):
        shutil.copyfile(path, tmp_path / path.name)
    whole = json.loads((SMALL / "differentiable.json").read_text("utf-8"))
    own = [one for one in whole["jobs"] if (one["target"], one["attack"]) == ("resnet34-furniture", "normals")]
    assert not any(one.get("fooled", False) for one in own)
    own[0] |= {"fooled": True, "p_loop": 0.0123}
    (tmp_path / "differentiable.json").write_text(json.dumps(whole), "utf-8")
    before, after = files(SMALL)[PAGE], files(tmp_path)[PAGE]
    verified, counted = "**verified**", "paper's count"
    assert row(after, "ResNet-34", verified) == row(before, "ResNet-34", verified)
    assert row(after, "ResNet-34", counted)[3] == f"{100 / len(own):.1f}\u00a0·\u00a012.3"


def test_successes_are_counted_by_the_share_of_the_image_that_shows_the_object(tmp_path: Path) -> None:
    """A view lies in the range whose lower edge it reaches; the held one had half of its covered pixels beyond U."""
    held = {"outcome": "held", "verified": False, "truncated": 45}
    jobs = [
        job(0.01, "a", attack="normals", scene="a", covered=90, pixels=1000, **held),
        job(0.01, "b", attack="normals", scene="b", covered=150, pixels=1000),
        job(0.01, "c", attack="combined", scene="b", covered=150, pixels=1000),
        job(0.01, "d", attack="image", scene="d", covered=90, pixels=1000),
    ]
    record = with_jobs("differentiable", [one.model_dump(mode="json") for one in jobs], tmp_path)
    _, _, thin, broad, _, said = tables.by_coverage([record]).splitlines()
    mesh = jobs[0].mesh.rpartition("/")[2]
    assert [cell.strip() for cell in thin.split("|")][2:8] == [
        "below 10 %",
        mesh,
        "1",
        "0\u00a0of\u00a01",
        "–",
        "50\u00a0%",
    ]
    wins = ["15–20 %", "–", "1", "1\u00a0of\u00a01", "1\u00a0of\u00a01", "–"]
    assert [cell.strip() for cell in broad.split("|")][2:8] == wins
    assert said.endswith("fooled: t 100.0 % by normals and 100.0 % by combined.")
    normals = next(line for line in tables.by_confidence([record]).splitlines() if " normals " in line)
    assert [cell.strip() for cell in normals.split("|")][3:9] == ["1", "100\u00a0%", "10.0", "1", "100\u00a0%", "10.0"]


def test_only_a_success_within_the_limit_counts_at_equal_p() -> None:
    jobs = [
        job(0.010, "a", azimuth=0.0, queries=30),
        job(0.021, "b", azimuth=1.0, queries=10),
        job(0.020, "c", azimuth=2.0, queries=300),
        job(0.010, "d", azimuth=3.0, queries=40, outcome="held"),
    ]
    run = equal_p.Run("ZOO", 20.0, jobs)
    assert [one.request for one in run.won] == ["a", "c"]
    assert run.by_queries == [(30.0, 1), (300.0, 2)]


def test_the_columns_of_the_campaign_at_equal_p_say_their_limit_and_share_a_budget() -> None:
    campaign = parse(json.loads((Path(__file__).parents[4] / "examples" / "paper-equal-p.json").read_text("utf-8")))
    for grid in campaign.grids:
        names = [column.name for column in grid.attacks]
        assert len({name.partition(equal_p.BETWEEN)[0] for name in names}) * 2 == len(names)  # each under two limits
        for column in grid.attacks:
            assert column.attack.constraint == "backtrack"
            assert column.attack.perceptibility == float(column.name.partition(equal_p.BETWEEN)[2]) / 1000
        assert len({column.attack.queries for column in grid.attacks} - {None}) == 1
        assert {column.attack.truncation for column in grid.attacks} == {None}


def test_a_column_of_another_name_is_refused() -> None:
    record = load(SMALL / "differentiable.json")
    with pytest.raises(ValueError, match="states no limit"):
        equal_p.runs(record, record.table().targets[0])


def test_rows_of_the_second_table_are_counts_of_its_jobs() -> None:
    text = tables.nondifferentiable(load(SMALL / "nondifferentiable.json")).replace("\u00a0", " ")
    assert "| **AlexNet** | paper: image, 500 steps | 99 of 102 | 97.1 |" in text
    assert "|  | paper: physical, 500 steps | 14 of 102 | 13.7 |" in text
    for attack in dict.fromkeys(one["attack"] for one in raw(SMALL / "nondifferentiable.json")):
        own = [one for one in raw(SMALL / "nondifferentiable.json") if one["attack"] == attack]
        assert f"| here: {attack} | **{sum(map(won, own))} of {len(own)}** |" in text
