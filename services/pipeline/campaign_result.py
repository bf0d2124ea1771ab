"""The result of a campaign, and the files that it is written into."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services import atomic_write
from services.analysis.campaign_curves import MeanCurves
from services.analysis.campaign_table import Table
from services.analysis.campaign_text import to_csv, to_latex
from services.pipeline.campaign_select import ChosenView


class CampaignResult(BaseModel):
    """The content of `table.json`: the table of the jobs that have ended, the mean curves, and all views."""

    model_config = ConfigDict(extra="forbid")

    table: Table
    curves: list[MeanCurves] = Field(description="means of the traces of all cases, by step")
    views: list[ChosenView] = Field(description="every view, with the first answer and why it is not attacked")


def write(result: CampaignResult, out: Path) -> list[Path]:
    """Writes table.json, table.csv, table.tex and curves.png into a folder, and returns their paths."""
    from services.analysis.campaign_figure import draw  # matplotlib takes a second to import

    texts = {
        "table.json": result.model_dump_json(indent=1) + "\n",
        "table.csv": to_csv(result.table),
        "table.tex": to_latex(result.table),
    }
    for name, text in texts.items():
        atomic_write.write(out / name, text.encode())
    draw(result.table, result.curves, out / "curves.png")
    return [out / name for name in (*texts, "curves.png")]
