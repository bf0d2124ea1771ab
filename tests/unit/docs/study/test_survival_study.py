"""The study of what adversaries survive: its rows are what its jobs say."""

import pytest

from benchmarks.study.pages import SURVIVAL
from benchmarks.study.record import load
from benchmarks.study.survival import before_cameras
from scene_attack.analysis.verdict import wilson
from tests.unit.docs.study.test_study_records import SMALL, raw, rows_of


def test_rows_are_means_over_the_verified() -> None:
    rows = {(row[0], row[1]): row[2:] for row in rows_of(before_cameras(load(SMALL / "survival.json")))}
    for target, name in (("alexnet-furniture", "**AlexNet**"), ("resnet34-furniture", "**ResNet-34**")):
        jobs = [job for job in raw(SMALL / "survival.json") if (job["target"], job["attack"]) == (target, "image")]
        won = [job for job in jobs if job["outcome"] == "fooled" and job["verified"]]
        shares = [job["survival"]["fooled"] / job["survival"]["right"] for job in won]
        low, high = wilson(sum(shares), len(shares))
        verified, p, right, survival, between, half = rows[name, "image"]
        assert verified.split() == [str(len(won)), "of", str(len(jobs))]
        assert float(p) == pytest.approx(1000 * sum(job["p"] for job in won) / len(won), abs=0.051)
        seen = [job["survival"]["right"] / job["survival"]["views"] for job in won]
        assert float(right) == pytest.approx(100 * sum(seen) / len(seen), abs=0.51)
        assert float(survival.strip("*")) == pytest.approx(100 * sum(shares) / len(shares), abs=0.51)
        assert between == f"{100 * low:.0f}–{100 * high:.0f}"
        assert half.split()[0] == str(sum(share >= 0.5 for share in shares))


def test_the_page_has_every_part() -> None:
    text = SURVIVAL.files(SMALL)["survival.md"]
    assert "{{" not in text
    assert "paper-survival.json" in text
