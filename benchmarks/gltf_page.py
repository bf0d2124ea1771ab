"""Writes docs/gltf.md from results/gltf_materials.json. No figure of that page is typed by hand."""

import json
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[1] / "docs" / "gltf.md"

REASONS = {
    "emissive": "Stock pyrender's shader multiplies the emission by its factor twice.",
    "masked": "Stock pyrender's shader has no alpha cutoff and its loader blends every material; the backs of double-sided "
    "faces keep the normal of the front, and are dark. glTF cuts out what is below the cutoff and turns the normal over.",
    "vertex-coloured": "Stock pyrender's loader drops vertex colours beside a material. Handed to it, they also tint the "
    "highlight, because its shader multiplies the reflected light by them; in glTF they belong to the base colour.",
    "nested transforms": "Stock pyrender does not turn the winding of a mirrored node over, and shows its inside.",
    "two UV sets": "Stock pyrender looks every texture up at the first set of texture coordinates.",
}
"""Why a model's difference may reach the limit."""

TEXT = """# glTF materials

An uploaded `glb` is drawn with the metallic-roughness materials that it states, by the pyrender renderer. Everything
else (the furniture library, primitives, and uploads as obj, ply, stl and off) has no such inputs and keeps the surface
of [how it works](how-it-works.md): a Lambertian body under a thin coat of roughness 0.45.

## What is kept of a file, and how it is shaded

| input | obj, ply, stl, off | glb, pyrender renderer | glb, torch renderer |
|---|---|---|---|
| base colour factor and texture | kept (`Kd`, `map_Kd`; no textures beside an uploaded file) | kept; textures are sRGB and decoded before they are filtered | kept |
| vertex and face colours | kept, one colour a face | `COLOR_0`, linear, multiplies the base colour | kept |
| metallic and roughness factors and texture | none | kept, with glTF's defaults of 1 where the file says nothing, also for a primitive without material | ignored: the object's `material` decides |
| emissive factor and texture | none | kept; adds to the radiance whatever the light | ignored |
| normal map and its scale | none | kept; tangents of the file, else derived from the texture coordinates | kept |
| occlusion map and its strength | none | kept; darkens the ambient light only | ignored |
| alpha mode | `d` and `Tr` of library furniture | `OPAQUE`, `MASK` with its cutoff, `BLEND` per texel | kept; `BLEND` as a share of the samples |
| `doubleSided` | both sides are drawn | backs of single-sided faces are culled; on the back of a double-sided face the normal is turned over | as pyrender |
| normals | smoothed below a crease of 40° | the file's; flat where it has none | as pyrender |
| texture coordinates | one set | `TEXCOORD_0` and `TEXCOORD_1`, wrap modes of the sampler | as pyrender |
| node transforms | | nested, as matrices or translation, rotation and scale; mirrored ones turn the winding over | as pyrender |

The BRDF is pyrender's: GGX with α = roughness², Schlick's Fresnel term from mix(0.04, base colour, metallic), Schlick's
approximation of Smith's shadowing with k = (roughness + 1)² / 8, and a diffuse body of 0.96 · base colour · (1 −
metallic). The ambient light is the renderer's sky (brighter above): a rough surface sees its cosine-weighted mean, a
smooth one what it mirrors. The object's `color` multiplies the base colour, and nothing else.

Not used: sampler filters (all maps are filtered linearly with mipmaps), skins, morph targets and animations (the file's
pose is drawn), cameras and lights of the file, and extensions that the file does not require. Refused, with the place in
the file: extensions in `extensionsRequired` other than `KHR_mesh_quantization`, compressed and sparse accessors,
textures that are not PNG or JPEG, factors that are not finite or out of range, buffers outside the file.

## Compared with stock pyrender

Ten models, one for each input, written by `benchmarks/gltf_models.py`. Both draw the same file under the same light
without ambient light; ours is put through stock pyrender's exposure, clamping and curve. Differences are means over the
covered pixels in 1/255. Where a mean reaches 2, stock pyrender drew the model again with what it leaves out put right
(`benchmarks/stock_pyrender.py`), which proves the reason."""


def page() -> str:
    """The whole page."""
    result: dict[str, Any] = json.loads((RESULTS / "gltf_materials.json").read_text("utf-8"))
    limit = result["limit"]
    lines = [
        "| model | point | directional | spot | with the reason put right | reason |",
        "|:---|---:|---:|---:|---:|:---|",
    ]
    for model in dict.fromkeys(row["model"] for row in result["rows"]):
        rows = [row for row in result["rows"] if row["model"] == model]
        means = [f"{row['mean']:.2f}" for row in rows]
        mended = [f"{row['mended']['mean']:.2f}" for row in rows if "mended" in row]
        reason = REASONS[model] if max(row["mean"] for row in rows) >= limit else ""
        lines.append(f"| {model} | {' | '.join(means)} | {', '.join(mended)} | {reason} |")
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    foot = f"`{result['command']}` ({versions}; {result['backend']})."
    rest = (
        "What remains elsewhere: texels at the edges of squares (stock pyrender filters sRGB before it decodes it), normals "
        "bent beyond the light (it lights them with a cosine of 0.001 and ours with 0), and the terminator's last pixels. "
        "With ambient light the two differ by design: stock pyrender adds ambient light times base colour, for metals too."
    )
    return "\n\n".join([TEXT, "\n".join(lines), rest, foot]) + "\n"
