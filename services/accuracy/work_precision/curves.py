"""The curves of the work-precision report, log-log, drawn with matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from services.accuracy.work_precision.attack_runs import AttackRow
from services.accuracy.work_precision.gradients import IMAGE, GradientRow
from services.accuracy.work_precision.shading_rows import ShadingRow
from services.accuracy.work_precision.success import curve

COLORS = ("#4a2fd6", "#0a5a94", "#0b6b3a", "#b26a00", "#a3182f", "#8b1a86", "#5d5875")
"""The dashboard's, as they stand on white paper."""
INK, SOFT, LINE = "#1c1930", "#5d5875", "#e2deef"
LEAST = 1e-12
"""Errors of nothing have no place on a logarithmic axis."""
STYLE: Any = {
    "font.size": 10,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "axes.grid": True,
    "axes.ymargin": 0.18,
    "grid.color": LINE,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "legend.fontsize": 8,
    "legend.frameon": False,
    "svg.hashsalt": "work-precision",
}


def draw(
    shading: Sequence[ShadingRow], gradients: Sequence[GradientRow], attacks: Sequence[AttackRow], path: Path
) -> None:
    """Twelve panels into a PNG."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(13, 27), layout="constrained")
        panels = figure.subplots(6, 2).flatten()
        measured = [row for row in shading if row.both is not None]
        first = [row for row in measured if row.mesh == measured[0].mesh]
        finest = max(first, key=lambda row: row.map[0] if row.map[0] <= 16 else 0).map
        middle = [row for row in first if row.map == finest]
        _image_error(panels[0], middle)
        _gradient_error(panels[1], middle)
        _map_sizes(panels[2], first)
        _single_groups(panels[3], middle)
        _steps(panels[4], [row for row in gradients if row.renderer == "torch"], "torch: gradients, against δ")
        drawn = [row for row in gradients if row.renderer == "pyrender" and row.samples == 4]
        _steps(panels[5], drawn, "pyrender, 4 samples a pixel: gradients, against δ")
        _samples(panels[6], [row for row in gradients if row.renderer == "pyrender"])
        _evaluations(panels[7], gradients)
        _success(panels[8], attacks, "queries")
        _perceptibility(panels[9], attacks, "queries")
        _success(panels[10], attacks, "seconds")
        _perceptibility(panels[11], attacks, "seconds")
        figure.savefig(path, dpi=110, facecolor="white", metadata={"Software": None})


def _finish(panel: Any, title: str, across: str, up: str, logarithmic: str = "xy") -> None:
    panel.set_title(title, loc="left")
    panel.set_xlabel(across)
    panel.set_ylabel(up)
    if "x" in logarithmic:
        panel.set_xscale("log")
    if "y" in logarithmic:
        panel.set_yscale("log")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_minor_formatter(NullFormatter())
    panel.spines[["top", "right"]].set_visible(False)
    if panel.get_legend_handles_labels()[0]:
        panel.legend(ncols=2)


def _seconds(row: ShadingRow) -> float | None:
    return None if row.both is None else row.both.median


def _tables(rows: Sequence[ShadingRow], per_pixel: int) -> list[ShadingRow]:
    return [r for r in rows if r.method == "table" and r.per_pixel_texels == per_pixel and r.dtype == "float32"]


def _plans(rows: Sequence[ShadingRow], groups: tuple[str, ...]) -> list[ShadingRow]:
    return [row for row in rows if row.method == "plan" and row.groups == groups and row.tolerance != "exact"]


def _image_error(panel: Any, rows: Sequence[ShadingRow]) -> None:
    counts = sorted({row.per_pixel_texels for row in rows if row.method == "table"})
    for color, count in zip(COLORS, counts, strict=False):
        own, label = _tables(rows, count), f"table, {count} per-pixel texels"
        panel.plot([_seconds(r) for r in own], [r.largest for r in own], "o-", color=color, label=label)
    for row, mark in zip([row for row in rows if row.method == "sum"], "sD^v", strict=False):
        name = f"sum, {row.dtype}{'' if row.kernel == 'native' else ', in torch'}"
        if row.largest:
            panel.plot([_seconds(row)], [row.largest], mark, color=INK, label=name)
        else:
            panel.axvline(_seconds(row), color=INK, linestyle=":", label=f"{name}: the reference")
    for row in _plans(rows, rows[0].groups):
        panel.plot([_seconds(row)], [row.largest], "*", color=COLORS[4], markersize=13)
        panel.annotate(f"plan, {row.tolerance:g}", (_seconds(row), row.largest), (7, 5), textcoords="offset points")
    texels = rows[0].map
    _finish(panel, f"Largest error of an image, map {texels[0]}×{texels[1]}", "seconds, with gradient", "error")


def _gradient_error(panel: Any, rows: Sequence[ShadingRow]) -> None:
    for color, group in zip(COLORS, rows[0].groups, strict=False):
        for count, line in ((0, ":"), (32, "-")):
            own = _tables(rows, count)
            label = f"{group}, {count} per-pixel texels"
            panel.plot(
                [_seconds(r) for r in own], [r.gradient[group] for r in own], f"o{line}", color=color, label=label
            )
        own = _plans(rows, rows[0].groups)
        panel.plot([_seconds(r) for r in own], [r.gradient[group] for r in own], "*", color=color, markersize=13)
    _finish(panel, "Error of gradients, by tables (stars: plans)", "seconds, with gradient", "relative error")


def _map_sizes(panel: Any, rows: Sequence[ShadingRow]) -> None:
    for color, texels in zip(COLORS, sorted({row.map for row in rows}), strict=False):
        of_map = [row for row in rows if row.map == texels]
        own = _tables(of_map, 8)
        name = f"{texels[0]}×{texels[1]}"
        panel.plot([r.evaluations for r in own], [r.largest for r in own], "o-", color=color, label=f"tables, {name}")
        own = _plans(of_map, rows[0].groups)
        panel.plot([r.evaluations for r in own], [r.largest for r in own], "*", color=color, markersize=13)
        [whole] = [r for r in of_map if r.method == "sum" and r.dtype == "float32" and r.kernel == "native"]
        panel.plot([whole.evaluations], [whole.largest], "s", color=color)
    title = "Largest error, by size of map: tables with 8 per-pixel texels,\nplans (stars), sums in float32 (squares)"
    _finish(panel, title, "lobe values of an image", "error")


def _single_groups(panel: Any, rows: Sequence[ShadingRow]) -> None:
    for color, groups in zip(COLORS, dict.fromkeys(r.groups for r in rows if r.method == "plan"), strict=False):
        own, name = _plans(rows, groups), "all" if len(groups) == 3 else groups[0]
        panel.plot(
            [_seconds(r) for r in own],
            [r.largest for r in own],
            "*-",
            color=color,
            markersize=11,
            label=f"plan, {name}",
        )
        panel.plot([_seconds(r) for r in own], [r.estimate for r in own], "_:", color=color, markersize=11)
        [exact] = [r for r in rows if r.method == "plan" and r.groups == groups and r.tolerance == "exact"]
        panel.axvline(_seconds(exact), color=color, linestyle="--", linewidth=1)
    title = "Plans by what is attacked; dotted: what they estimate;\ndashed: seconds of the exact way"
    _finish(panel, title, "seconds, with gradient", "largest error")


def _steps(panel: Any, rows: Sequence[GradientRow], title: str) -> None:
    stepped = [row for row in rows if row.directions is None]
    kinds = (("float64", "central", "-", 1), ("float32", "central", "-", 2), ("float32", "forward", "--", 1))
    for color, (group, of) in zip(COLORS, dict.fromkeys((r.group, r.of) for r in stepped), strict=False):
        name = group if of == IMAGE else f"{group}, {of}"
        for image, estimator, line, width in (*kinds, ("8 bit", "central", ":", 1)):
            own = [r for r in stepped if (r.group, r.of, r.image, r.estimator) == (group, of, image, estimator)]
            label = name if (image, estimator) == ("float32", "central") else None
            errors = [max(r.error, r.floor, LEAST) for r in own]
            marker = "x" if image == "float64" else ""
            panel.plot([r.delta for r in own], errors, f"{marker}{line}", color=color, linewidth=width, label=label)
    known = "thick: central, float32; dashed: forward; dotted: 8 bit" + (
        "; crosses: float64" if "torch" in title else ""
    )
    _finish(panel, f"{title}\n{known}", "δ, in the group's units", "relative error")


def _samples(panel: Any, rows: Sequence[GradientRow]) -> None:
    for color, group in zip(COLORS, ("light position", "translation", "rotation"), strict=False):
        for samples, line in ((1, ":"), (4, "-")):
            own = [
                r for r in rows if (r.group, r.samples, r.image, r.estimator) == (group, samples, "float32", "central")
            ]
            errors = [max(r.error, r.floor) for r in own]
            panel.plot([r.delta for r in own], errors, f"o{line}", color=color, label=f"{group}, {samples} a pixel")
    _finish(
        panel, "pyrender: one sample a pixel and four, central differences", "δ, in the group's units", "relative error"
    )


def _evaluations(panel: Any, rows: Sequence[GradientRow]) -> None:
    seen = [r for r in rows if r.image == "float32" and r.of == IMAGE and r.samples in (None, 4)]
    for color, group in zip((*COLORS, INK), dict.fromkeys(r.group for r in seen), strict=False):
        own = [r for r in seen if r.group == group and r.directions is not None]
        panel.plot(
            [r.evaluations for r in own],
            [r.error for r in own],
            "o-",
            color=color,
            label=f"{group}, {own[0].dimensions}",
        )
        best = min((r for r in seen if r.group == group and r.estimator == "central"), key=lambda r: r.error)
        panel.plot([best.evaluations], [max(best.error, best.floor)], "D", color=color)
    title = (
        "Random directions (legend: dimensions) and the best central\ndifferences (diamonds; torch: of 8 coordinates)"
    )
    _finish(panel, title, "evaluations of the function", "relative error")


def _kinds(attacks: Sequence[AttackRow]) -> list[tuple[str, list[AttackRow]]]:
    kinds = dict.fromkeys((a.method, a.renderer, a.groups) for a in attacks)
    named = []
    for method, renderer, groups in kinds:
        name = f"{method} {'all of ' + renderer if len(groups) > 1 else groups[0]}"
        of = [a for a in attacks if (a.method, a.renderer, a.groups) == (method, renderer, groups)]
        named.append((name, of))
    return named


def _success(panel: Any, attacks: Sequence[AttackRow], along: Literal["queries", "seconds"]) -> None:
    reached = [float(getattr(a, along)) for a in attacks if a.steps]
    for color, (name, own) in zip(COLORS, _kinds(attacks), strict=False):
        some = [a for a in own if a.tolerance != "exact" or a.renderer == "image"]
        points = [(min(reached), 0.0), *curve(some, along)]
        points.append((max(reached), points[-1][1]))
        panel.step([x for x, _ in points], [y for _, y in points], where="post", color=color, label=name)
    panel.set_ylim(-0.03, 1.03)
    _finish(panel, f"Share of attacks that were verified, against {along}", along, "share", "x")


def _perceptibility(panel: Any, attacks: Sequence[AttackRow], along: Literal["queries", "seconds"]) -> None:
    for color, (_, own) in zip(COLORS, _kinds(attacks), strict=False):
        for exact, mark in ((False, "o"), (True, "s")):
            some = [a for a in own if (a.tolerance == "exact") == exact and a.perceptibility]
            for won in (True, False):
                marked = [a for a in some if (a.outcome == "verified") == won]
                x, y = [getattr(a, along) for a in marked], [a.perceptibility for a in marked]
                panel.plot(x, y, mark, color=color, markerfacecolor=color if won else "none")
    title = f"p at the end, against {along}, colours as beside;\nhollow: held; squares: exact, circles: within 1e-3"
    _finish(panel, title, along, "p")
