"""The committed result of scenes that other people made: what the page says of it, and how it counts pixels."""

import json
from pathlib import Path

import numpy as np

from benchmarks.scene_files import CONTROLLERS, SAMPLES, RoundTrip, _differing, _in_a_unit

ROOT = Path(__file__).parents[3]
REPORT = json.loads((ROOT / "benchmarks/results/scene_files.json").read_text("utf-8"))


def test_the_page_says_what_was_measured() -> None:
    rows, summary = [RoundTrip.model_validate(row) for row in REPORT["rows"]], REPORT["summary"]
    assert [row.file for row in rows] == ["/".join(Path(name).parts[-2:]) for name in (*SAMPLES, *CONTROLLERS)]
    assert all(row.pixels_changed_by_attack for row in rows)
    equal = [row for row in rows if row.original_differs == row.attacked_differs == 0]
    page = " ".join((ROOT / "docs/results.md").read_text("utf-8").split())
    said = f"In {len(equal)} of [{len(rows)} scenes of other people](../benchmarks/results/scene_files.json)"
    assert said in page
    elsewhere = sum(row.original_differs_elsewhere for row in rows)
    assert f"{elsewhere} of {sum(row.pixels for row in rows):,} pixels" in page
    assert summary["scenes_equal_to_the_pixel"] == len(equal)
    assert max(row.off_from_trimesh for row in rows) < 1e-6


def test_a_pixel_differs_if_a_channel_does_and_points_are_compared_in_a_unit_box() -> None:
    image = np.zeros((2, 3, 3), np.uint8)
    other = image.copy()
    other[0, 1], other[1, 2, 2] = 9, 1
    assert _differing(image, image) == 0
    assert _differing(image, other) == 2
    assert _in_a_unit(np.array([[2.0, 1, 1], [6, 2, 1]])).tolist() == [[0, 0, 0], [1, 0.25, 0]]
