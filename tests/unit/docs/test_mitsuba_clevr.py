"""The committed comparison of CLEVR-style scenes with Mitsuba holds what docs/scene.md says of it."""

import json
import re
from pathlib import Path

from benchmarks.mitsuba_clevr import LIMIT, SCENES
from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[3] / "docs" / "scene.md"
FOUND = json.loads((RESULTS / "mitsuba_clevr.json").read_text("utf-8"))["rows"]


def test_both_renderers_are_within_the_limit_on_every_scene() -> None:
    for renderer in ("pyrender", "torch"):
        rows = [row for row in FOUND if row["renderer"] == renderer]
        assert {row["scene"] for row in rows} == set(range(SCENES))
        for row in rows:
            assert row["pixels"] > 1000  # not judged on a handful
            assert 0 < row["objects"] < LIMIT


def test_the_page_gives_the_least_and_the_largest_difference() -> None:
    [text] = re.findall(
        r"ten CLEVR-style scenes.*?\(`benchmarks/mitsuba_clevr.py`\)", PAGE.read_text("utf-8"), re.DOTALL
    )
    said = [float(number) for number in re.findall(r"\d+\.\d+", text)]
    values = [[row["objects"] for row in FOUND if row["renderer"] == name] for name in ("pyrender", "torch")]
    assert said == [round(bound(own), 1) for own in values for bound in (min, max)]
