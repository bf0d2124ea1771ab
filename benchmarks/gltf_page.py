"""Writes the table of docs/reports/gltf.md from results/gltf_materials.json; none of its figures is typed by hand."""

import json
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[1] / "docs" / "reports" / "gltf.md"
REASONS = {
    "emissive": "Stock pyrender's shader multiplies the emission by its factor twice.",
    "masked": "Stock pyrender's shader has no alpha cutoff and its loader blends every material; the backs of "
    "double-sided faces keep the normal of the front, and are dark. glTF cuts out what is below the cutoff and turns "
    "the normal over.",
    "vertex-coloured": "Stock pyrender's loader drops vertex colours beside a material. Handed to it, they also tint "
    "the highlight, because its shader multiplies the reflected light by them; in glTF they belong to the base colour.",
    "nested transforms": "Stock pyrender does not turn the winding of a mirrored node over, and shows its inside.",
    "two UV sets": "Stock pyrender looks every texture up at the first set of texture coordinates.",
}
"""The reason for which the difference of a model reaches the limit."""
REST = """What remains elsewhere: texels at the edges of squares (stock pyrender filters sRGB before it decodes it),
normals bent beyond the light (it lights them with a cosine of 0.001, we with 0), and the edges of a mask (cut by texels
here, by faces where stock pyrender is put right). With ambient light the two differ by design: stock pyrender adds
ambient light times base colour, for metals too."""
_HEAD = ("model", "point", "directional", "spot", "with the reason put right", "reason")


def page() -> str:
    """The page with the part that follows from the result written again."""
    result: dict[str, Any] = json.loads((RESULTS / "gltf_materials.json").read_text("utf-8"))
    lines = [_row(_HEAD), "|:---|---:|---:|---:|---:|:---|"]
    for model in dict.fromkeys(row["model"] for row in result["rows"]):
        rows = [row for row in result["rows"] if row["model"] == model]
        mended = ", ".join(f"{row['mended']['mean']:.2f}" for row in rows if "mended" in row)
        reason = REASONS[model] if max(row["mean"] for row in rows) >= result["limit"] else ""
        lines.append(_row((model, *(f"{row['mean']:.2f}" for row in rows), mended, reason)))
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    foot = f"`{result['command']}` ({versions}; {result['backend']})."
    words = PAGE.read_text("utf-8").split(_row(_HEAD))[0]
    return words + "\n\n".join(["\n".join(lines), REST, foot]) + "\n"


def _row(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
