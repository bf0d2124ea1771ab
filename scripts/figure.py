"""Draws a figure for the documentation from a result: original, attacked, perturbation, with the network's answers.

scene-attack run examples/torch-combined.json --out out/combined
.venv/bin/python scripts/figure.py out/combined docs/images/combined.png
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from services.pipeline.result import Result

SIDE, GAP, CAPTION = 336, 12, 60
PAPER, INK, SOFT = "#ffffff", "#1c1930", "#5d5875"


def figure(directory: Path) -> Image.Image:
    result = Result.model_validate_json((directory / "result.json").read_bytes())
    p = result.perceptibility if result.float_perceptibility is None else result.float_perceptibility
    perceptibility = f"p = {p:.4f}"
    panels = [
        ("original.png", f"{result.original.label}, {result.original.confidence:.0%}", "original"),
        ("attacked.png", f"{result.attacked.label}, {result.attacked.confidence:.0%}", "attacked, rendered afresh"),
        ("perturbation.png", "the difference, 5 times", perceptibility),
    ]
    sheet = Image.new("RGB", (3 * SIDE + 2 * GAP, SIDE + CAPTION), PAPER)
    draw = ImageDraw.Draw(sheet)
    for index, (name, title, note) in enumerate(panels):
        left = index * (SIDE + GAP)
        with Image.open(directory / name) as image:
            sheet.paste(image.convert("RGB").resize((SIDE, SIDE), Image.Resampling.LANCZOS), (left, 0))
        draw.text((left, SIDE + 8), title, INK, ImageFont.load_default(19))
        draw.text((left, SIDE + 34), note, SOFT, ImageFont.load_default(15))
    return sheet


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    figure(Path(sys.argv[1])).save(sys.argv[2], optimize=True)
