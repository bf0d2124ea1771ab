"""Draws a white sphere of every material preset under several environment maps, for docs/reports/materials.md.

python scripts/draw_materials.py               writes docs/images/materials.png
python scripts/draw_materials.py --help        what can be set
"""

import argparse
from pathlib import Path

import torch
from PIL import Image

from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.torch.dsbrdf import presets
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.runs.environment import options_to_run
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "materials.png", help="file to write")
    parser.add_argument("--maps", nargs="+", default=["studio", "interior", "city", "courtyard", "night", "sunrise"])
    parser.add_argument("--mesh", default="primitive/sphere", help="one row of images per preset shows this mesh")
    parser.add_argument("--size", type=int, default=160, help="pixels a side of one image")
    arguments = parser.parse_args()
    settings = options_to_run()
    library = Library(settings.cache_dir, settings.data_dir)
    rows = []
    for material in presets():
        row = []
        for name in arguments.maps:
            description = Scene.model_validate(
                {
                    "camera": {"size": (arguments.size, arguments.size)},
                    "objects": [{"mesh": arguments.mesh, "material": material}],
                    "lights": {"environment": {"map": name}},
                }
            )
            scene = resolve(description, library)
            row.append(to_bytes(TorchRenderer(scene, rasterise(scene), tolerance="exact").render({})[0]))
        rows.append(torch.cat(row, dim=1))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(torch.cat(rows).numpy()).save(arguments.out, optimize=True)


if __name__ == "__main__":
    main()
