"""`scene-attack run` with each attack on a piece of furniture: its result file, its counts and its objective."""

import json
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.integration.test_run import cli

pytestmark = pytest.mark.integration

SCENE = {
    "objects": [{"mesh": "furniture/soccer-ball"}],
    "camera": {"size": [96, 96]},
    "lights": {"environment": {"size": [8, 16]}},
}
PIXELS = {"renderer": "image", "base_renderer": "pyrender"}
ATTACKS: dict[str, tuple[dict[str, Any], int]] = {
    "mi-fgsm": ({"groups": ["normals"], "truncation": 6, "constraint": "backtrack", "steps": 2}, 1),
    "apgd": ({"groups": ["normals", "illumination"], "loss": "dlr", "steps": 3, "restarts": 1}, 1),
    "cma-es": ({"renderer": "pyrender", "groups": ["color", "illumination"], "population": 6, "steps": 2}, 7),
    "natural-gradient": ({"renderer": "pyrender", "steps": 3}, 1),
    "p-rgf": ({"renderer": "pyrender", "groups": ["color"], "steps": 2}, 9),
    "spsa": ({"renderer": "pyrender", "groups": ["rotation", "illumination"], "steps": 2}, 33),
    "square": (PIXELS | {"steps": 8}, 1),
}
"""The settings of each, and its queries a step."""


@pytest.mark.parametrize("method", ATTACKS)
def test_it_runs_on_furniture(method: str, tmp_path: Path) -> None:
    settings, per_step = ATTACKS[method]
    spec = {"scene": SCENE, "attack": settings | {"method": method}}
    done = cli("run", "-", "--out", os.fspath(tmp_path / "out"), stdin=json.dumps(spec))
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    rows = result["trace"]
    assert rows[0]["distance"] == 0
    assert min(row["advantage"] for row in rows) < rows[0]["advantage"]
    asked = [after["queries"] - before["queries"] for before, after in pairwise(rows)]
    verified = [before["advantage"] < 0 for before in rows[:-1]]  # such an image is asked for once more
    if method != "apgd":  # whose restart begins with a row that follows no step
        assert asked == [per_step + again for again in verified]
    assert result["stopped"] == "verified" or rows[-1]["restart"] == settings.get("restarts", 0)
    if settings.get("constraint") == "backtrack":
        assert result["beyond_truncation"] == 0
