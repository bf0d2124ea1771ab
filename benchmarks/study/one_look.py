"""The table of networks that know one look beside those that were trained on many, and beside the paper's."""

from collections.abc import Sequence

from benchmarks.study.record import Record
from benchmarks.study.tables import (
    BETWEEN,
    SETTING,
    bold,
    both,
    decimal,
    interval,
    markdown,
    ordered,
    paper,
    title,
    truncated,
)
from scene_attack.analysis.campaign_table import Cell

GROUPS = ("illumination", "material")
TRAINED = {"one-look": "one look", "furniture": "varied looks"}
"""How a network was trained, by the end of its name; before it is the architecture's."""


def light_and_material(records: Sequence[Record]) -> str:
    """For each training and setting the views fooled by light and by material, with p, and truncated pixels.

    Columns are called "<group>" or "<group>, <setting>"; a setting's row has both groups where both have it, and
    other columns are left out.
    """
    found = {(cell.target, cell.attack): cell for record in records for cell in record.table().cells}
    named = [attack.partition(SETTING) for _, attack in found]
    settings = dict.fromkeys(setting for group, _, setting in named if group in GROUPS)
    stated = paper()["classification"]["differentiable"]
    rows: list[list[str]] = []
    for target in ordered({target for target, _ in found if target.endswith("-one-look")}):
        architecture = target.removesuffix("-one-look")
        shipped = f"{architecture}-furniture"
        theirs = stated["targets"][shipped]
        block = [["paper", str(stated["views"]), *(text for group in GROUPS for text in _paper(theirs, group))]]
        for ending, words in TRAINED.items():
            for setting in settings:
                names = [f"{group}{SETTING}{setting}" if setting else group for group in GROUPS]
                cells = [found.get((f"{architecture}-{ending}", name)) for name in names]
                views = sorted({cell.success.of for cell in cells if cell is not None})
                if views:
                    about = f"{words}, {setting}" if setting else words
                    ours = (text for cell in cells for text in _ours(cell))
                    block.append([about, " and ".join(map(str, views)), *ours])
        rows += [[f"**{title(shipped)}**" if place == 0 else "", *row] for place, row in enumerate(block)]
    heads = (
        "network",
        "trained on",
        "n",
        *(
            head
            for group in GROUPS
            for head in (f"{group}, paper's count", "verified", "95\u00a0% interval", "truncated")
        ),
    )
    return markdown(heads, rows, texts=2)


def _ours(cell: Cell | None) -> tuple[str, str, str, str]:
    return both(cell, "loop_success"), bold(both(cell, "success")), interval(cell), truncated(cell)


def _paper(theirs: dict[str, list[float | None]], group: str) -> tuple[str, str, str, str]:
    place: int = paper()["classification"]["differentiable"]["columns"].index(group)
    stated = f"{theirs['success'][place]:.1f}{BETWEEN}{theirs['p'][place]:.1f}"
    return stated, "", "", decimal(theirs["truncated"][place])
