"""Writes docs/reports/benchmarks.md from the committed results. No figure of that page is typed by hand.

Run after any benchmark: python -m benchmarks.page
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[1] / "docs" / "reports" / "benchmarks.md"


def page() -> str:
    """The whole page as Markdown."""
    sections = (_shading, _jobs, _image_attacks, _peer_attacks, _zoo, _differences, _surrogates, _questions)
    return "\n\n".join(["# Benchmarks", INTRODUCTION, *(part for section in sections for part in section())]) + "\n"


INTRODUCTION = """Each table is of one run of one command, after a warm-up: times are the shortest of several repeats
(of jobs the median), ratios are of numbers of the same run, side by side. `benchmarks/setup` installs the peers. Errors
are of displayed values in [0,1]."""


def _result(name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    return loaded


def _table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    columns = list(columns)
    rule = [":---", *("---:" for _ in columns[1:])]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (columns, rule, *rows))


def _foot(result: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    seed = "" if result["seed"] is None else f", seed {result['seed']}"
    return f"<small>`{result['command']}`{seed}; {result['backend']}; {versions}; {result['machine']}</small>"


def _shading() -> list[str]:
    result = _result("shading")
    rows = [
        [
            f"{row['method']}, {row['groups']}" + (f", {row['tolerance']}" if "tolerance" in row else ""),
            f"{1e3 * row['seconds']:.0f}",
            f"{row['times faster than chunked eager']:.3g}",
            f"{row['max']:.1e}" if "max" in row else "",
            f"{row['estimated']:.1e}" if "estimated" in row else "",
        ]
        for row in result["rows"]
    ]
    parts = [
        "## Shading",
        f"An image of {result['pixels']:,} object pixels at 448² under 512 directions, 3 lobes × RGB, and the "
        "gradients of the attacked groups. *Chunked* and *one shot* are plain torch with autograd.",
        _table(("way, attacked, tolerance", "ms", "× chunked", "error", "estimated"), rows),
    ]
    if result["mitsuba"]:
        mitsuba = [
            [
                str(row["samples"]),
                f"{1e3 * row['seconds']:.0f}",
                f"{row['times slower than ours, all groups']:.3g}",
                f"{row['rms']:.1e}",
                f"{row['rms / ours']:.3g}",
            ]
            for row in result["mitsuba"]["rows"]
        ]
        parts += [
            f"Mitsuba {result['mitsuba']['mitsuba']} on a problem of the same size, against its own of many samples:",
            _table(("samples", "ms", "× ours, all groups", "RMS error", "× ours"), mitsuba),
        ]
    return [*parts, _foot(result)]


def _jobs() -> list[str]:
    result = _result("jobs")
    rows = [
        [
            row["attack"],
            f"{row['loop s']:.2f}",
            f"{row['loop / network']:.2f}",
            f"{row['job / network']:.2f}",
            f"{row['peak MiB at 448²']:.0f}",
        ]
        for row in result["rows"]
    ]
    return [
        "## FGSM jobs",
        f"Jobs of {result['steps']} steps at 224², each step beside a forward and backward pass of EfficientNet-Lite0 "
        "alone. Memory is the peak of a fresh process at 448².",
        _table(("attacked", "loop s", "loop / network", "job / network", "MiB"), rows),
        _foot(result),
    ]


def _image_attacks() -> list[str]:
    result = _result("image_attacks")
    timing = [
        [str(value) if not isinstance(value, float) else f"{value:.3g}" for value in row.values()]
        for row in result["timing"]
    ]
    success = [
        [str(value) if not isinstance(value, float) else f"{value:.3g}" for value in row.values()]
        for row in result["success"]
    ]
    return [
        "## Attacks on pixels",
        result["about"].split("\n\n")[1].replace("\n", " "),
        _table(result["timing"][0], timing),
        _table(result["success"][0], success),
        _foot(result),
    ]


def _peer_attacks() -> list[str]:
    result = _result("peer_attacks")
    used = result["settings"]
    rows = [
        [
            row["attack"],
            f"{row['fooled']} of {row['of']}",
            f"{row['margin']:.2f}",
            "" if row["queries"] is None else f"{row['queries']:.1f}",
        ]
        for row in result["rows"]
    ]
    return [
        "## Attacks on pixels by several packages",
        *(part.replace("\n", " ").strip() for part in result["about"].split("\n\n")[1:]),
        f"ε is {used['epsilon']}/255, for Square {used['square epsilon']}/255; APGD takes {used['steps']} steps, "
        f"Square at most {used['queries']} queries.",
        _table(("attack", "fooled", "margin", "queries"), rows),
        _foot(result),
    ]


def _zoo() -> list[str]:
    result = _result("zoo_step")
    rows = [
        [
            view["mesh"],
            f"{view['faces']:,}",
            f"{1e3 * view['seconds']['zoo_step']:.0f}",
            *(
                f"{view['ratios'][name]:.2f}"
                for name in (
                    "zoo_step / network_28",
                    "loop_of_28 / zoo_step",
                    "images_28_alone / images_28_shared",
                    "frame / stock_pyrender_frame",
                )
            ),
        ]
        for view in result["views"]
    ]
    return [
        "## A step of ZOO",
        "Differences of all 14 coordinates on pyrender at 224², beside the network's batch of 28, and beside a loop "
        "that renders a frame and asks the network one at a time; its 28 images beside OpenGL's one by one, and a "
        "frame beside stock pyrender's.",
        _table(
            (
                "mesh",
                "faces",
                "step ms",
                "step / network",
                "loop / step",
                "OpenGL / images",
                "frame / stock frame",
            ),
            sorted(rows, key=lambda row: int(row[1].replace(",", ""))),
        ),
        _foot(result),
    ]


def _differences() -> list[str]:
    result = _result("image_differences")
    rows = [
        [
            row["mesh"],
            row["way"],
            "yes" if row["verified"] else "no",
            str(row["steps"]),
            f"{row['queries']:,}",
            f"{1e3 * row['p']:.0f}",
            " → ".join(f"{value:.2f}" for value in row["advantage"]),
            " → ".join(f"{row['objective'][key]:.2f}" for key in ("start", "lowest", "end")),
            str(row["objective"]["step of lowest"]),
        ]
        for row in result["rows"]
    ]
    queries = result["queries"]
    steps = ", ".join(f"{group} {1e3 * p:.1f}" for group, p in result["steps"].items())
    return [
        "## Gradients by differences of the image",
        "Attacks on the paper's 14 parameters of pyrender at 224² without a limit U. *fgsm* takes the network's "
        "gradient with respect to the image times differences of the image, *zoo* differences of the network's "
        "objective; both with their defaults, and *zoo* with the paper's settings. The objective is stated at the "
        "start, at its lowest and at the end.",
        _table(
            ("mesh", "attack", "verified", "steps", "queries", "p ×10⁻³", "advantage", "objective", "lowest at step"),
            rows,
        ),
        f"Of {queries['fooled by fgsm']} views that *fgsm* fools with {queries['queries of fgsm']:,} queries in all, "
        f"*zoo* fools {queries['of these by zoo']} with {queries['queries of zoo']:,}, and "
        f"{queries['within 10 times the queries']} within ten times the queries of *fgsm*. p of one step at random "
        f"signs, ×10⁻³: {steps}.",
        _foot(result),
    ]


def _surrogates() -> list[str]:
    result = _result("surrogates")
    rows = [
        [
            f"{row['target']}, {row['renderer']}, {row['surrogate'] or 'none'}",
            f"{row['verified']} of {row['views']}",
            f"{row['queries']:,}",
            f"{row['fall']:.2f}",
            "" if row["surrogate"] is None or row["without"] is None else f"{row['without']:.2f}",
        ]
        for row in result["summary"]
    ]
    return [
        "## Queries that a surrogate saves",
        f"p-rgf with {result['pairs']} random directions a step, a rate of {result['rate']:g} ε and at most "
        f"{result['budget']} queries; on pixels ε is 8/255. Views are of models that neither furniture network was "
        "trained on. *Queries* are the sum over all views, those that held counted with all of theirs. *Fall* is the "
        "mean of the fall of the advantage. *Without* is the sum of the same search without a surrogate over this one: "
        "a lower bound where that search held more often.",
        _table(("target, renderer, surrogate", "verified", "queries", "fall", "without"), rows),
        "Weights: " + ", ".join(f"{name} `{sha[:12]}`" for name, sha in result["weights"].items()) + ".",
        _foot(result),
    ]


def _questions() -> list[str]:
    result = _result("questions")
    rows = [
        [
            row["case"],
            f"{1e3 * row['seconds']['batch']:.0f}",
            f"{1e3 * row['seconds']['one at a time']:.0f}",
            f"{row['ratio']:.1f}",
            f"{row['processor_ratio']:.1f}",
            f"{row['largest_difference']:.1e}",
        ]
        for row in result["rows"]
    ]
    return [
        "## Questions",
        f"{result['questions']} questions of mixed programs, with {result['mean_nodes']:.1f} functions on average, to "
        "IEP's network: as one batch and one at a time. The project accepts ratios of processor time from "
        f"{result['least']:g} on. {result['note']}",
        _table(("case", "batch ms", "one at a time ms", "ratio", "of processor time", "difference of scores"), rows),
        _foot(result),
    ]


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
    print(f"written to {PAGE}")
