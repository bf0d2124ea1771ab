"""The table of networks that know one look beside those that were trained on many, and beside the paper's."""

from benchmarks.study.record import Record
from benchmarks.study.tables import BETWEEN, NONE, markdown, milli, ordered, paper, title
from scene_attack.analysis.campaign_table import Cell

GROUPS = ("illumination", "material")
TRAINED = {"one-look": "one look", "furniture": "varied looks"}
"""How a network was trained, by the end of its name; before it is the architecture's."""


def light_and_material(record: Record) -> str:
    """For each training and setting the views fooled by light and by material, p, intervals and truncated pixels.

    Columns are called "<group>" or "<group>, <setting>"; a setting's row has both groups where both have it.
    """
    table = record.table()
    settings = dict.fromkeys(attack.partition(", ")[2] for attack in table.attacks)
    stated = paper()["classification"]["differentiable"]
    rows: list[list[str]] = []
    for shipped in ordered({f"{target.partition('-')[0]}-furniture" for target in table.targets}):
        theirs = stated["targets"][shipped]
        block = [["paper", str(stated["views"]), *(text for group in GROUPS for text in _paper(theirs, group))]]
        for ending, words in TRAINED.items():
            for setting in settings:
                names = [f"{group}, {setting}" if setting else group for group in GROUPS]
                cells = [table.cell(f"{shipped.partition('-')[0]}-{ending}", name) for name in names]
                views = sorted({cell.success.of for cell in cells if cell is not None})
                if views:
                    about = f"{words}, {setting}" if setting else words
                    texts = (text for cell in cells for text in _texts(cell))
                    block.append([about, " and ".join(map(str, views)), *texts])
        rows += [[f"**{title(shipped)}**" if number == 0 else "", *row] for number, row in enumerate(block)]
    heads = (
        "network",
        "trained on",
        "n",
        *(head for group in GROUPS for head in (group, "95 % interval", "truncated")),
    )
    return markdown(heads, rows, texts=2)


def _paper(theirs: dict[str, list[float | None]], group: str) -> tuple[str, str, str]:
    place: int = paper()["classification"]["differentiable"]["columns"].index(group)
    truncated = theirs["truncated"][place]
    stated = f"{theirs['success'][place]:.1f}{BETWEEN}{theirs['p'][place]:.1f}"
    return stated, "", NONE if truncated is None else f"{truncated:.1f}"


def _texts(cell: Cell | None) -> tuple[str, str, str]:
    """Per cent fooled, verified, with the mean p; its interval; and pixels beyond U in some step, as a mean."""
    if cell is None or cell.success.rate is None or cell.success.low is None or cell.success.high is None:
        return "", "", ""
    fooled = f"**{100 * cell.success.rate:.1f}{BETWEEN}{milli(cell.perceptibility)}**"
    interval = f"{100 * cell.success.low:.1f}–{100 * cell.success.high:.1f}"
    return fooled, interval, NONE if cell.truncated is None else f"{cell.truncated:,.1f}"
