"""Writes the tables of docs/stock-pyrender.md from results/own_meshes.json; no figure of them is typed by hand."""

import json
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[1] / "docs" / "stock-pyrender.md"
GREY = "No colour is read: stock pyrender draws 0.3 of white, we a light grey."
EDGES = "Stock pyrender smooths normals over every edge, we below 40°."
TEXELS = "Stock pyrender averages texels as they are stored, in sRGB, and we as light."
WEIGHTS = "Normals are means of those of the faces, with other weights."
REASONS = {
    "fuze.obj": f"{TEXELS} {WEIGHTS}",
    "capsule.obj": f"{TEXELS} Of 2,048 texels, we keep 1,024.",
    "spider.obj": "The material library names textures with backslashes, and the loader finds none of them.",
    "fuze.ply": f"The loader dims a texture without material by a grey of its own. {TEXELS} {WEIGHTS}",
    "reference.ply": "Stock pyrender takes vertex colours for linear light, blends them between the corners of a "
    "triangle, and draws their opacity: see the notes.",
    "featuretype.STL": f"{GREY} {EDGES}",
    "ballA.off": GREY,
    "BoxTextured.gltf": "The loader drops the sampler, by which the texture is mirrored where it repeats.",
    "ClearCoatTest.gltf": f"{TEXELS} Neither draws the clear coat.",
    "TestScene.gltf": "Stock pyrender’s shader multiplies the emission by its factor twice.",
    "AlphaBlendModeTest.glb": "Stock pyrender has no alpha cutoff, blends every material and draws some that blend "
    f"before what is behind them; the backs of double-sided faces keep the normal of the front. {TEXELS}",
    "featuretype.3MF": f"{GREY} {EDGES}",
    "box.3mf": f"{GREY} {EDGES}",
}
"""The reason for which the difference of a model reaches the limit."""
_HEAD = (
    "model", "triangles", "mean", "beyond 8/255", "put right", "alike", "alike, fine", "ours to fine", "stock to fine",
    "light, ours", "light, stock", "why stock pyrender differs",
)  # fmt: skip
_SAID = ("model", "used", "notes")


def page() -> str:
    """The page with the part that follows from the result written again."""
    result: dict[str, Any] = json.loads((RESULTS / "own_meshes.json").read_text("utf-8"))
    lines = [_row(_HEAD), "|:---|" + "---:|" * 10 + ":---|"]
    for row in result["rows"]:
        apart = [row, row["mended"], row["alike"], row["alike_fine"], *row["to_fine"].values(), *row["light"].values()]
        first, *others = (f"{one['mean']:.2f}" for one in apart)
        reason = REASONS[row["model"]] if row["mean"] >= result["limit"] else ""
        share = f"{100 * row['share_beyond_8']:.0f} %"
        lines.append(_row((f"`{row['model']}`", f"{row['triangles']:,}", first, share, *others, reason)))
    said = [_row(_SAID), "|:---|:---|:---|"]
    for row in result["rows"]:
        said.append(_row((f"`{row['model']}`", "; ".join(row["used"]), "; ".join(row["notes"]))))
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    foot = f"`{result['command']}` ({versions}; {result['backend']})."
    words = PAGE.read_text("utf-8").split(_row(_HEAD))[0]
    return words + "\n\n".join(["\n".join(lines), "\n".join(said), foot]) + "\n"


def _row(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
