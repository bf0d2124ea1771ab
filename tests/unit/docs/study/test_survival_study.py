"""The study of what adversaries survive: its rows are what its jobs say."""

import pytest

from benchmarks.study.examples import Example, Opinion
from benchmarks.study.pages import SURVIVAL
from benchmarks.study.record import load
from benchmarks.study.survival import before_cameras, drawn_by_others, pictures
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


def test_survivors_are_of_the_verified_whose_scene_is_right_in_the_other_renderer() -> None:
    """Those that are still wrong there, as they are without the attack, count nowhere."""
    rows = rows_of(drawn_by_others(load(SMALL / "second-opinion.json")))
    rows = [row[1:] for row in rows if row[1] == "pyrender"]  # AlexNet's, then ResNet-34's
    everything = raw(SMALL / "second-opinion.json")
    for target, row in zip(("alexnet-furniture", "resnet34-furniture"), rows, strict=True):
        jobs = [job for job in everything if (job["target"], job["attack"]) == (target, "pyrender")]
        asked = [job["second_opinion"] for job in jobs if "second_opinion" in job]
        assert row[1].split() == [str(len(asked)), "of", str(len(jobs))]
        for renderer, cell in zip(("blender", "mitsuba", "stock-pyrender"), row[3:], strict=True):
            right = [words[renderer] for words in asked if words[renderer] != "still-wrong"]
            fooled, of = right.count("fooled"), len(right)
            low, high = wilson(fooled, of)
            assert cell == f"**{fooled} of {of}**<br>{100 * low:.0f}–{100 * high:.0f} %"


def test_an_example_is_shown_as_each_renderer_draws_it() -> None:
    opinions = (Opinion(renderer="blender", after="table", after_confidence=0.91, outcome="held"),)
    about = {"campaign": "second-opinion", "target": "alexnet-furniture", "attack": "bump", "mesh": "a", "request": "b"}
    answers = {"before": "table", "before_confidence": 0.96, "after": "cabinet", "after_confidence": 0.4}
    example = Example(name="x-1", **about, **answers, p=0.015, credits=(), opinions=opinions)
    assert example.files["second_opinion_blender_attacked.png"] == "x-1-blender.png"
    [row] = rows_of(pictures([example]))
    assert "(x-1-blender.png)" in row[-1]
    assert "table, 91%: held" in row[-1]
