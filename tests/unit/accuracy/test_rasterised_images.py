"""The comparison of 5,000 images in short: one scene of one or two objects, and one of three or more."""

import json
from pathlib import Path

import pytest

from benchmarks.rasterised_images import beyond, compare, scenes
from scene_attack.scenes.library import Library
from scene_attack_service.settings import Settings

pytestmark = pytest.mark.slow

PAGES = Path(__file__).parents[3] / "docs" / "accuracy"


def test_no_image_is_off_by_more_than_its_plan_says() -> None:
    library = Library(Settings().cache_dir, Settings().data_dir)
    rows = [compare(scene, library, 1) for scene in scenes(2)]
    assert [len(row["meshes"]) >= 3 for row in rows] == [False, True]
    assert all(row["rasterised"] and row["images"] > 40 for row in rows)
    assert beyond(rows) == []
    assert beyond([rows[0] | {"mean": 2 * rows[0]["plan_mean"]}]) != []
    assert max(row["gradients"] for row in rows) < 0.1


def test_the_committed_report_says_what_the_page_says() -> None:
    report = json.loads((PAGES / "rasterised_images.json").read_text("utf-8"))
    found = report["summary"]
    assert found["scenes"] == len(report["rows"]) == 60
    assert found["scenes_beyond_estimate"] == len(beyond(report["rows"])) == 0
    images = sum(row["images"] for row in report["rows"])
    assert images == found["images"] >= 5000
    assert f"{images:,} images over 60 random scenes" in (PAGES.parent / "accuracy.md").read_text("utf-8")
    text = " ".join((PAGES.parent / "how-it-works.md").read_text("utf-8").split())
    assert f"[comparison of {images:,} images]" in text
