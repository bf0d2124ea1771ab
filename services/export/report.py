"""A page about a job that needs no other file: images, tables, curves and the request, without scripts."""

import json
from base64 import b64encode
from collections.abc import Sequence

from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import BaseModel

from services.attacks.trace import TraceRow
from services.export.files import Files
from services.export.parameters import ParameterTable
from services.export.readme import bibtex, sentence
from services.pipeline.names import attack_name, group_words
from services.pipeline.result import Result
from services.text import signed

WIDTH, HEIGHT = 420, 160
"""Size of a curve's box, SVG units."""
IMAGES = (
    ("original.png", "Original"),
    ("attacked.png", "Attacked"),
    ("perturbation.png", "Difference × 5, plus 128"),
)

_templates = Environment(
    loader=PackageLoader(__package__), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=True
)
_templates.filters["zip"] = zip
_templates.globals["signed"] = signed


class Curve(BaseModel):
    """A curve over the steps: its points in SVG units, and the values at its ends."""

    title: str
    points: str
    first: float
    last: float
    lowest: float
    highest: float


def report(result: Result, name: str, table: ParameterTable, files: Files, job: str | None) -> str:
    """The page as HTML. `name` is the scene's or question's; `files` has the images, which become a part of it."""
    return _templates.get_template("report.html").render(
        name=name,
        attack=attack_name(result.spec),
        job=job,
        result=result,
        sentence=sentence(result),
        images=[(title, _inline(files[name]())) for name, title in IMAGES if name in files],
        curves=curves(result.trace),
        groups=[[group_words(result.spec, group) for group in one.groups] for one in result.subsets],
        parts=[group_words(result.spec, part) for part in result.attribution.parts],
        table=table,
        request=json.dumps(result.spec, indent=2, ensure_ascii=False),
        bibtex=bibtex(),
    )


def curves(trace: Sequence[TraceRow]) -> list[Curve]:
    """The curves of a trace of two rows or more."""
    if len(trace) < 2:
        return []
    return [
        _curve("Loss: probability of the labels to leave, or 1 − that to reach", trace, [row.loss for row in trace]),
        _curve("Perceptibility p", trace, [row.perceptibility for row in trace]),
    ]


def _curve(title: str, trace: Sequence[TraceRow], values: Sequence[float]) -> Curve:
    low, high = min(values), max(values)
    first, span = trace[0].step, max(1, trace[-1].step - trace[0].step)
    tall = (high - low) or 1.0
    points = [
        f"{WIDTH * (row.step - first) / span:.2f},{HEIGHT * (1 - (value - low) / tall):.2f}"
        for row, value in zip(trace, values, strict=True)
    ]
    ends = {"first": values[0], "last": values[-1], "lowest": low, "highest": high}
    return Curve(title=title, points=" ".join(points), **ends)


def _inline(png: bytes) -> str:
    return f"data:image/png;base64,{b64encode(png).decode()}"
