"""Writes the table of docs/stock-pyrender.md from results/own_meshes.json; no figure of its table is typed by hand."""

import json
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[1] / "docs" / "stock-pyrender.md"
GREY = "No colour is read: stock pyrender draws 0.3 of white, we a light grey."
EDGES = "Stock pyrender smooths normals over every edge, we below 40°."
TEXELS = "What is left is at thin lines and small texels, which the two average differently."
REASONS = {
    "fuze.obj": TEXELS,
    "capsule.obj": TEXELS,
    "spider.obj": "The material library names textures with backslashes, and the loader finds none of them.",
    "fuze.ply": f"The loader dims a texture without material by a grey of its own. {TEXELS}",
    "reference.ply": "Stock pyrender takes vertex colours for linear light. What is left is in the notes.",
    "featuretype.STL": f"{GREY} {EDGES}",
    "ballA.off": GREY,
    "BoxTextured.gltf": "The loader drops the sampler, by which the texture is mirrored where it repeats.",
    "ClearCoatTest.gltf": f"{TEXELS} Neither draws the clear coat.",
    "TestScene.gltf": "Stock pyrender’s shader multiplies the emission by its factor twice.",
    "CesiumMilkTruck.glb": TEXELS,
    "AlphaBlendModeTest.glb": "Stock pyrender has no alpha cutoff and blends every material (see glTF materials).",
    "featuretype.3MF": f"{GREY} {EDGES}",
    "box.3mf": f"{GREY} {EDGES}",
}
"""The reason for which the difference of a model reaches the limit."""
_HEAD = ("model", "triangles", "mean", "beyond 8/255", "put right", "used", "notes", "why stock pyrender differs")


def page() -> str:
    """The page with the part that follows from the result written again."""
    result: dict[str, Any] = json.loads((RESULTS / "own_meshes.json").read_text("utf-8"))
    lines = [_row(_HEAD), "|:---|---:|---:|---:|---:|:---|:---|:---|"]
    for row in result["rows"]:
        mended = f"{row['mended']['mean']:.2f}" if "mended" in row else ""
        reason = REASONS[row["model"]] if row["mean"] >= result["limit"] else ""
        said = ("; ".join(row["used"]), "; ".join(row["notes"]))
        figures = (f"{row['triangles']:,}", f"{row['mean']:.2f}", f"{100 * row['share_beyond_8']:.0f} %", mended)
        lines.append(_row((f"`{row['model']}`", *figures, *said, reason)))
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    foot = f"`{result['command']}` ({versions}; {result['backend']})."
    words = PAGE.read_text("utf-8").split(_row(_HEAD))[0]
    return words + "\n\n".join(["\n".join(lines), foot]) + "\n"


def _row(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
