"""A campaign at the terminal: its progress, its table, and the results and images in its folder or at a service."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import TYPE_CHECKING

from rich.text import Text

from scene_attack.cli.console import FittedTable, remark
from scene_attack.cli.progress import LOG_EVERY, ProgressLine
from scene_attack.errors import InvalidRequest

if TYPE_CHECKING:
    from scene_attack.analysis.campaign_table import Cell, Rate, Table
    from scene_attack.client.client import Client
    from scene_attack.client.schemas import CampaignJobView
    from scene_attack.runs.campaign_run import CampaignProgress
    from scene_attack.runs.result import Result

STYLES = {"finished": "green", "running": "cyan", "selecting": "cyan", "paused": "yellow", "cancelled": "yellow"}


def campaign_state(state: str) -> Text:
    """The state of a campaign, in its colour."""
    return Text(state, style=STYLES.get(state, "red"))


def results(found: "Table") -> FittedTable:
    """The table of a campaign: a row for each target and attack."""
    columns = ("target", "attack", "ended>", "n>", "success %>", "95 % interval>", "p ×1e-3>", "held within ε>")
    loop = ("in the loop %>", "p in the loop ×1e-3>", "truncated px>", "survival %>", "failed>", "reused>")
    opinions = tuple(f"survive in {name}>" for name in found.renderers)
    spare: tuple[str, ...] = ("reused", "held within ε", "truncated px", "failed", "in the loop %", "ended", "n")
    if not any(cell.survival for cell in found.cells):
        spare = ("survival %", *spare)
    rows = [
        [*_row(cell), *(_opinion(cell.second_opinion.get(name)) for name in found.renderers)] for cell in found.cells
    ]
    return FittedTable((*columns, *loop, *opinions), rows, title=found.campaign, spare=spare)


def _opinion(survivors: "Rate | None") -> str:
    """The adversaries that survive another renderer, with the interval of their share."""
    if survivors is None or survivors.low is None or survivors.high is None:
        return ""
    low, high = _number(survivors.low, 100), _number(survivors.high, 100)
    return f"{survivors.count} of {survivors.of} ({low}–{high} %)"


def _row(cell: "Cell") -> list[str | Text]:
    success = cell.success
    interval = "–".join(_number(bound, 100) for bound in (success.low, success.high) if bound is not None)
    return [
        cell.target,
        cell.attack,
        f"{cell.ended}/{cell.jobs}",
        str(success.of),
        _number(success.rate, 100),
        interval,
        _number(cell.perceptibility, 1000),
        str(cell.held_within_epsilon or ""),
        _number(cell.loop_success.rate, 100),
        _number(cell.loop_perceptibility, 1000),
        _number(cell.truncated, 1),
        "" if cell.survival is None else _number(cell.survival.mean, 100),
        str(cell.failed or ""),
        str(cell.reused or ""),
    ]


def _number(value: float | None, factor: float) -> str:
    return "" if value is None else f"{value * factor:.1f}"


def duration(seconds: float | None) -> str:
    """A time in words, e.g. "1 h 05 min", "3 min" or "20 s"; empty for None."""
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"


class CampaignLine(ProgressLine):
    """Shows the progress of a campaign."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._logged = float("-inf")

    def update(self, progress: "CampaignProgress") -> None:
        """Shows the progress of the campaign."""
        things = "views" if progress.phase == "selecting" else "jobs"
        won = sum(case.success for case in progress.cases)
        left = duration(progress.seconds_left)
        parts = [f"{won} successes" if progress.cases else "", f"{left} left" if left else "", progress.now]
        now = "  ".join(part for part in parts if part)
        self._bar.update(self._task, description=progress.phase, completed=progress.done, total=progress.total, now=now)
        last = progress.done == progress.total
        if self._logs and (last or monotonic() - self._logged > LOG_EVERY):
            self._logged = monotonic()
            remark(f"{progress.phase} {progress.done}/{progress.total} {things}  {now}")


IMAGES = ("original.png", "attacked.png")


def folder_results(folder: Path) -> Iterator[tuple["Result", Path]]:
    """The result of each job in the folder of `campaign run` and the folder of its images, in the table's order.

    Raises InvalidRequest("source") if the folder is not one.
    """
    import json

    from scene_attack.runs.result import Result

    try:
        requests = json.loads((folder / "jobs.json").read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidRequest(
            "source", f"{folder} is not the folder of a campaign that has been run: {error}"
        ) from error
    for request in requests:
        place = folder / "jobs" / str(request)
        if (place / "result.json").exists():
            yield Result.model_validate_json((place / "result.json").read_bytes()), place


def service_results(client: "Client", campaign_id: str) -> Iterator[tuple["Result", Path]]:
    """The result of each job that succeeded, and a folder with its images that lasts until the next result."""
    from scene_attack.client import operations

    for planned in _planned(client, campaign_id):
        if planned.job is None or planned.state != "succeeded":
            continue
        with TemporaryDirectory() as folder:
            for name in IMAGES:
                client.save(operations.download_artifact(planned.job, name), Path(folder) / name)
            yield client.get_job(planned.job).result, Path(folder)


def _planned(client: "Client", campaign_id: str) -> Iterator["CampaignJobView"]:
    from scene_attack.client import operations

    after: int | None = -1
    while after is not None:
        page = client.call(operations.list_campaign_jobs(campaign_id, after=after))
        yield from page.items
        after = page.next
