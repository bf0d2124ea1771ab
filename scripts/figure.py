"""Draws a figure for the documentation from a result: original, attacked, perturbation, with the network's answers
and the question, if it was asked one.

scene-attack run examples/torch-physical.json --out out/physical
.venv/bin/python scripts/figure.py out/physical docs/images/physical.png
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from scene_attack.runs.result import Result

SIDE, GAP, HEADING, CAPTION = 336, 12, 34, 60
PAPER, INK, SOFT = "#ffffff", "#1c1930", "#5d5875"


def figure(directory: Path) -> Image.Image:
    result = Result.model_validate_json((directory / "result.json").read_bytes())
    perceptibility = f"p = {result.p:.4f}"
    panels = [
        ("original.png", f"{result.original.label}, {result.original.confidence:.0%}", "original"),
        ("attacked.png", f"{result.attacked.label}, {result.attacked.confidence:.0%}", "attacked, rendered afresh"),
        ("perturbation.png", "the difference, 5 times", perceptibility),
    ]
    rows, columns = result.spec["scene"]["camera"]["size"]
    questions = result.tasks["questions"].questions if result.tasks else []
    side, top = SIDE * rows // columns, HEADING * len(questions)
    sheet = Image.new("RGB", (3 * SIDE + 2 * GAP, top + side + CAPTION), PAPER)
    draw = ImageDraw.Draw(sheet)
    for index, question in enumerate(questions):
        draw.text((0, HEADING * index), question.question or "", INK, ImageFont.load_default(19))
    for index, (name, title, note) in enumerate(panels):
        left = index * (SIDE + GAP)
        with Image.open(directory / name) as image:
            sheet.paste(image.convert("RGB").resize((SIDE, side), Image.Resampling.LANCZOS), (left, top))
        draw.text((left, top + side + 8), title, INK, ImageFont.load_default(19))
        draw.text((left, top + side + 34), note, SOFT, ImageFont.load_default(15))
    return sheet


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    figure(Path(sys.argv[1])).save(sys.argv[2], optimize=True)
