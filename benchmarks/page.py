"""Writes docs/reports/benchmarks.md from the committed results. No figure of that page is typed by hand.

Run after any benchmark: python -m benchmarks.page
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS
from scene_attack_accuracy.tables import table

PAGE = Path(__file__).parents[1] / "docs" / "reports" / "benchmarks.md"
INTRODUCTION = """# Benchmarks

Each table is of one run of one command, after a warm-up: times are the shortest of several repeats
(of jobs the median), ratios are of numbers of the same run, side by side. `benchmarks/setup` installs the peers. Errors
are of displayed values in [0,1]."""

Row = dict[str, Any]
Cell = Callable[[Row], str]


@dataclass(frozen=True)
class Rows:
    """A table: the rows of a result, and for each heading the function that writes a cell of its column."""

    of: Callable[[Row], list[Row]]
    columns: dict[str, Cell]


@dataclass(frozen=True)
class Section:
    """A result by its name, and its part of the page: text with {fields} of the result, and tables."""

    heading: str
    result: str
    parts: tuple[str | Rows, ...]

    def lines(self) -> Iterator[str]:
        """The paragraphs, the last of which is the provenance."""
        result = load(self.result)
        yield f"## {self.heading}"
        for part in self.parts:
            yield table(part.columns, part.of(result)) if isinstance(part, Rows) else part.format_map(result)
        yield provenance(result)


def load(name: str) -> Row:
    """A committed result."""
    loaded: Row = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    return loaded


def provenance(result: Row) -> str:
    """The command, seed, backend, versions and machine of a result."""
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    seed = "" if result["seed"] is None else f", seed {result['seed']}"
    return f"<small>`{result['command']}`{seed}; {result['backend']}; {versions}; {result['machine']}</small>"


def number(key: str, form: str, times: float = 1) -> Cell:
    """A value of a row as text, multiplied by `times`; empty if the row lacks it."""
    return lambda row: "" if row.get(key) is None else format(row[key] if times == 1 else times * row[key], form)


def milliseconds(key: str = "seconds") -> Cell:
    """Seconds of a row as milliseconds."""
    return number(key, ".0f", 1e3)


SECTIONS = (
    Section(
        "Shading",
        "shading",
        (
            "An image of {pixels:,} object pixels at 448² under 512 directions, 3 lobes × RGB, and the gradients of "
            "the attacked groups. *Chunked* and *one shot* are plain torch with autograd.",
            Rows(
                lambda result: result["rows"],
                {
                    "way, attacked, tolerance": lambda row: ", ".join(
                        str(row[key]) for key in ("method", "groups", "tolerance") if key in row
                    ),
                    "ms>": milliseconds(),
                    "× chunked>": number("times faster than chunked eager", ".3g"),
                    "error>": number("max", ".1e"),
                    "estimated>": number("estimated", ".1e"),
                },
            ),
            "Mitsuba {mitsuba[mitsuba]} on a problem of the same size, against its own of many samples:",
            Rows(
                lambda result: result["mitsuba"]["rows"],
                {
                    "samples>": number("samples", "d"),
                    "ms>": milliseconds(),
                    "× ours, all groups>": number("times slower than ours, all groups", ".3g"),
                    "RMS error>": number("rms", ".1e"),
                    "× ours>": number("rms / ours", ".3g"),
                },
            ),
        ),
    ),
    Section(
        "FGSM jobs",
        "jobs",
        (
            "Jobs of {steps} steps at 224², each step beside a forward and backward pass of EfficientNet-Lite0 alone. "
            "Memory is the peak of a fresh process at 448².",
            Rows(
                lambda result: result["rows"],
                {
                    "attacked": number("attack", ""),
                    "loop s>": number("loop s", ".2f"),
                    "loop / network>": number("loop / network", ".2f"),
                    "job / network>": number("job / network", ".2f"),
                    "MiB>": number("peak MiB at 448²", ".0f"),
                },
            ),
        ),
    ),
    Section(
        "The camera beside nrtk",
        "sensor",
        (
            "Settings of [the camera](../how-it-works.md#a-camera-in-between) and their counterparts in nrtk "
            "{peers[nrtk]}, on `{mesh}` drawn by pyrender; in 1/255, over the whole image. *changed* is what the "
            "setting itself changes in the mean.",
            Rows(
                lambda result: result["rows"],
                {
                    "setting": number("setting", ""),
                    "nrtk's": number("peer", ""),
                    "changed>": number("changed", ".2f"),
                    "apart, mean>": number("mean", ".2f"),
                    "apart, largest>": number("largest", ".0f"),
                },
            ),
            "Sharpening is Pillow's in both, and agrees to rounding. nrtk blurs and resizes displayed values, where a "
            "lens blurs light, by kernels of whole pixels; its JPEG files are OpenCV's. `BrightnessPerturber` "
            "multiplies displayed values, which is no exposure: half a stop less is a factor of about 0.85 on them. "
            "nrtk has no white balance. Its noise is as strong in the dark as in the light; a sensor's is not. "
            "Standard deviation at ISO 1600 and of `GaussianNoisePerturber` of the same strength in the middle, by the "
            "displayed value:",
            Rows(
                lambda result: result["noise"],
                {
                    "displayed value>": number("level", "g"),
                    "the camera's>": number("ours", ".2f"),
                    "nrtk's>": number("theirs", ".2f"),
                },
            ),
        ),
    ),
    Section(
        "Attacks on pixels by several packages",
        "peer_attacks",
        (
            "All attack the same images, which the network classifies correctly, with the same ε, step size and number "
            "of steps, and without ending early; so what is compared is the method, not the loop around it. Every "
            "adversary is rounded to 8 bits and classified by the same network: *fooled* counts those whose label is "
            "not the right one any more, *margin* is the mean of the right label's score over the largest other, which "
            "the methods lower. Ours see the rounded image inside the attack, the others the unrounded one. APGD and "
            "Square begin at random; two seeds of one package show the noise. Square ends at the first success: "
            "*queries* is the mean over all images, those that held counted with all their queries.",
            "Foolbox's MI-FGSM for L∞ does not divide the gradients by their ℓ1 norm, which the paper (Dong et al. "
            "2018, equation 6) does, so it is listed but not the same method. Foolbox has no APGD and no Square.",
            "ε is {settings[epsilon]}/255, for Square {settings[square epsilon]}/255; APGD takes {settings[steps]} "
            "steps, Square at most {settings[queries]} queries.",
            Rows(
                lambda result: result["rows"],
                {
                    "attack": number("attack", ""),
                    "fooled>": lambda row: f"{row['fooled']} of {row['of']}",
                    "margin>": number("margin", ".2f"),
                    "queries>": number("queries", ".1f"),
                },
            ),
        ),
    ),
    Section(
        "A step of ZOO",
        "zoo_step",
        (
            "Differences of all 14 coordinates on pyrender at 224², beside the network's batch of 28, and beside a "
            "loop that renders a frame and asks the network one at a time; its 28 images beside OpenGL's one by one, "
            "and a frame beside stock pyrender's.",
            Rows(
                lambda result: sorted(result["views"], key=lambda view: int(view["faces"])),
                {
                    "mesh": number("mesh", ""),
                    "faces>": number("faces", ",d"),
                    "step ms>": lambda row: milliseconds("zoo_step")(row["seconds"]),
                    "step / network>": lambda row: number("zoo_step / network_28", ".2f")(row["ratios"]),
                    "loop / step>": lambda row: number("loop_of_28 / zoo_step", ".2f")(row["ratios"]),
                    "OpenGL / images>": lambda row: number("images_28_alone / images_28_shared", ".2f")(row["ratios"]),
                    "frame / stock frame>": lambda row: number("frame / stock_pyrender_frame", ".2f")(row["ratios"]),
                },
            ),
        ),
    ),
    Section(
        "Path tracers",
        "path_tracing",
        (
            "The grand piano with shadows at 112² on {threads} threads, against an image of {reference_samples:,} "
            "samples: errors are over covered pixels.",
            Rows(
                lambda result: [
                    {"renderer": tracer["renderer"], **row} for tracer in result["tracers"] for row in tracer["error"]
                ],
                {
                    "renderer": number("renderer", ""),
                    "samples>": number("samples", "d"),
                    "frame ms>": milliseconds(),
                    "mean error>": number("mean", ".4f"),
                    "RMS error>": number("rms", ".4f"),
                },
            ),
            "A frame of 16 samples by threads, of which other work on the machine takes some:",
            Rows(
                lambda result: [
                    {"renderer": tracer["renderer"], **tracer["seconds_of_16_samples_by_threads"]}
                    for tracer in result["tracers"]
                ],
                {
                    "renderer": number("renderer", ""),
                    "1 thread, ms>": milliseconds("1"),
                    "2 threads, ms>": milliseconds("2"),
                },
            ),
            "A step of ZOO over all 14 coordinates through Blender beside the network's batch of 28, and the cosine of "
            "two estimates of the gradient under other seeds: where all images of an estimate share one, and where "
            "each has its own.",
            Rows(
                lambda result: result["zoo"],
                {
                    "samples>": number("samples", "d"),
                    "step ms>": lambda row: milliseconds("zoo_step")(row["seconds"]),
                    "network ms>": lambda row: milliseconds("network_28")(row["seconds"]),
                    "cosine, one seed>": lambda row: number("one seed for both sides", ".3f")(
                        row["cosine_of_gradients"]
                    ),
                    "cosine, a seed each>": lambda row: number("a seed for each image", ".3f")(
                        row["cosine_of_gradients"]
                    ),
                },
            ),
        ),
    ),
)


def page() -> str:
    """The whole page as Markdown."""
    return "\n\n".join([INTRODUCTION, *(line for section in SECTIONS for line in section.lines())]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
    print(f"written to {PAGE}")
