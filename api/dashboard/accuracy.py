"""Route of the page about accuracy: plots of the measurements that docs/accuracy reports, and their tables."""

import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response

from api.authentication import CallerDependency
from api.dashboard import words
from api.dashboard.pages import html
from api.dashboard.scatter import Point, Scatter, scatter

RESULTS = Path(__file__).parents[2] / "docs" / "accuracy"
"""The folder of the measurements, which is beside the packages in the repository and in the image."""
ERRORS: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "largest": lambda row: row["largest"],
    "rms": lambda row: row["rms"],
    "gradient of normals": lambda row: row["gradient"].get("normals", 0.0),
}
"""The errors of shading: of displayed values in [0,1], and of a gradient relative to its norm."""
OUTCOMES = ("ok", "flat", "clipped", "refused", "failed")
Text = Annotated[str, Query(max_length=200)]
Row = dict[str, Any]

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class Choices:
    """The values of a field of the form, and the chosen one."""

    name: str
    label: str
    values: list[str]
    chosen: str


@dataclass(frozen=True)
class Section:
    """A part of the page: its choices, its plot if any point has a place in it, and the rows that are plotted."""

    choices: list[Choices]
    plot: Scatter | None
    rows: Sequence[Row]


@router.get("/accuracy")
def accuracy(
    caller: CallerDependency,
    scene: Text = "",
    groups: Text = "",
    error: Text = "",
    parameter: Text = "",
    family: Text = "",
) -> Response:
    """The page."""
    work, stability = results("work-precision"), results("stability")
    if work is None or stability is None:
        return html("accuracy.html", caller=caller, work=None)
    return html(
        "accuracy.html",
        caller=caller,
        work=work,
        stability=stability,
        shading=shading(work["shading"], scene, groups, error),
        gradients=gradients(work["gradients"], parameter),
        cases=cases(stability["cases"], family),
    )


@cache
def results(name: str) -> dict[str, Any] | None:
    """The measurements of a report; None if this installation lacks the file."""
    try:
        found: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    except FileNotFoundError:
        return None
    return found


def scene_of(row: Row) -> str:
    """The scene of a measurement of shading, e.g. "furniture/soccer-ball, map 16×32"."""
    return f"{row['mesh']}, map {row['map'][0]}×{row['map'][1]}"


def shading(rows: Sequence[Row], scene: str, groups: str, error: str) -> Section:
    """The error of shading against seconds, of one scene and one choice of groups, by method."""
    scenes = list(dict.fromkeys(map(scene_of, rows)))
    scene = scene if scene in scenes else scenes[0]
    rows = [row for row in rows if scene_of(row) == scene]
    chosen = list(dict.fromkeys(", ".join(row["groups"]) for row in rows))
    groups = groups if groups in chosen else chosen[0]
    error = error if error in ERRORS else "largest"
    shown = [row | {"error": ERRORS[error](row)} for row in rows if ", ".join(row["groups"]) == groups]
    points: dict[str, list[Point]] = defaultdict(list)
    for row in shown:
        seconds = row["both"]["median"]
        text = f"{_method(row)}: error {row['error']:.1e}, {seconds:.2g} s"
        points[f"{row['method']}, {row['dtype']}"].append(Point(seconds, row["error"], text))
    plot = scatter("Error of shading against time", "seconds of an image and its gradient", "error", points)
    choices = [
        Choices("scene", "Scene", scenes, scene),
        Choices("groups", "Groups", chosen, groups),
        Choices("error", "Error", list(ERRORS), error),
    ]
    return Section(choices, plot, shown)


def _method(row: Row) -> str:
    settings = [
        f"{row['rows']} rows" if row["rows"] else "",
        f"{row['per_pixel_texels']} texels per pixel" if row["per_pixel_texels"] else "",
        f"tolerance {words.small(row['tolerance'])}" if row["tolerance"] else "",
    ]
    return ", ".join([row["method"], row["dtype"], *filter(None, settings)])


def gradients(rows: Sequence[Row], parameter: str) -> Section:
    """The error of estimated gradients against the step δ, of one renderer and group, by estimator and image."""
    parameters = list(dict.fromkeys(f"{row['renderer']} {row['group']}" for row in rows))
    parameter = parameter if parameter in parameters else parameters[0]
    shown = [row for row in rows if f"{row['renderer']} {row['group']}" == parameter]
    points: dict[str, list[Point]] = defaultdict(list)
    for row in shown:
        text = f"{row['estimator']}, {row['image']}: δ {row['delta']:.0e}, error {row['error']:.1e}"
        points[f"{row['estimator']}, {row['image']}"].append(Point(row["delta"], row["error"], text))
    plot = scatter("Error of a gradient by differences", "step δ", "relative error", points)
    return Section([Choices("parameter", "Renderer and group", parameters, parameter)], plot, shown)


def cases(rows: Sequence[Row], family: str) -> Section:
    """What was measured of each case of the stability suite, over its tolerance, by outcome."""
    families = list(dict.fromkeys(row["family"] for row in rows))
    shown = [row for row in rows if family in ("", row["family"])]
    points: dict[str, list[Point]] = {name: [] for name in OUTCOMES}
    for row in shown:
        if row["measured"] is not None:
            text = f"{row['family']}: {row['name']}: {row['measured']:.1e} of {row['tolerance']:.1e}"
            points[row["outcome"]].append(Point(row["tolerance"], row["measured"], text))
    plot = scatter("Measured error against what is tolerated", "tolerance", "measured", points)
    return Section([Choices("family", "Family", ["", *families], family if family in families else "")], plot, shown)
