"""The command `campaign run`: a campaign in this process, without a service."""

from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Self

import typer

from client.commands.options import JsonOption

if TYPE_CHECKING:
    from services.pipeline.campaign_run import CampaignProgress

SpecArgument = Annotated[str, typer.Argument(metavar="SPEC", help="A campaign as JSON; - reads it from stdin.")]


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(
        epilog="Examples: [bold]scene-attack campaign run examples/campaign-small.json --out out/small[/bold]\n\n"
        "[bold]scene-attack campaign run - --out out/x < campaign.json[/bold]"
    )(run)


def run(
    spec: SpecArgument,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the table and all results; default: out/<name of the campaign>.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a campaign without a service, and write its table, curves and results.

    If it is interrupted, the same command goes on with what is left.
    """
    from client import spec_input
    from client.campaign_tables import results
    from client.commands.run import keep_memory, library, prepare_folder
    from client.console import err, print_json, report_extensions
    from client.console import out as stdout
    from services.device import check_device
    from services.pipeline.campaign_check import check_meshes, check_size
    from services.pipeline.campaign_spec import parse
    from services.scenes.catalogue import slugify
    from services.settings import settings

    check_device()
    keep_memory()
    report_extensions()
    campaign = parse(spec_input.read(spec))
    check_size(campaign, settings().max_campaign_jobs)
    folder = out or Path("out") / (slugify(campaign.name) or "campaign")
    prepare_folder(folder)
    assets = library()
    check_meshes(campaign, assets.check_mesh)
    from services.pipeline.campaign_result import write
    from services.pipeline.campaign_run import run_campaign

    try:
        with CampaignLine(campaign.name) as line:
            found = run_campaign(campaign, folder, assets, progress=line.update)
    except KeyboardInterrupt:
        err().print("Interrupted; the same command goes on with what is left.", markup=False, highlight=False)
        raise
    write(found, folder)
    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        stdout().print(results(found.table.model_dump(mode="json")))
    chosen = sum(view.chosen for view in found.views)
    err().print(f"{chosen} of {len(found.views)} views attacked. Files in {folder}", markup=False, highlight=False)


class CampaignLine:
    """Shows the progress of a campaign: a bar with the time left or, without a terminal, a line every few seconds."""

    def __init__(self, name: str) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        from client.console import err

        console = err()
        self._log = None if console.is_terminal else console
        self._logged = float("-inf")
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn())
        rest = (TimeElapsedColumn(), TextColumn("{task.fields[now]}"))
        self._bar = Progress(*columns, *rest, console=console, disable=self._log is not None)
        self._task = self._bar.add_task(name, total=None, now="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, progress: "CampaignProgress") -> None:
        """Shows how far the campaign is."""
        from time import monotonic

        from client.campaign_tables import duration
        from client.live import LOG_EVERY

        things = "views" if progress.phase == "selecting" else "jobs"
        won = sum(case.success for case in progress.cases)
        left = duration(progress.seconds_left)
        parts = [f"{won} successes" if progress.cases else "", f"{left} left" if left else "", progress.now]
        now = "  ".join(part for part in parts if part)
        self._bar.update(self._task, description=progress.phase, completed=progress.done, total=progress.total, now=now)
        last = progress.done == progress.total
        if self._log is not None and (last or monotonic() - self._logged > LOG_EVERY):
            self._logged = monotonic()
            line = f"{progress.phase} {progress.done}/{progress.total} {things}  {now}"
            self._log.print(line, markup=False, highlight=False)
