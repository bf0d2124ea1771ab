"""The commands `campaign`: many attacks that belong together, in this process or at a service."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scene_attack.cli.commands.options import SHORT, JsonOption, PriorityOption, UrlOption, whole_campaign_id
from scene_attack.cli.console import FittedTable, print_found, print_json, remark, report_plugins, say
from scene_attack.client import DEFAULT_URL
from scene_attack.errors import InvalidRequest
from scene_attack.extras import MissingExtra

if TYPE_CHECKING:
    from rich.text import Text

    from scene_attack.client.operations import Answer, Request
    from scene_attack.client.schemas import CampaignView

app = typer.Typer(
    help="Run many attacks that belong together, and make the paper's table of them.", no_args_is_help=True
)

CampaignId = Annotated[
    str, typer.Argument(metavar="ID", help="The id that `campaign submit` printed, or its beginning.")
]
SpecArgument = Annotated[str, typer.Argument(metavar="SPEC", help="A campaign as JSON; - reads it from stdin.")]


@app.command(
    epilog="Examples: [bold]scene-attack campaign run examples/campaign-small.json --out out/small[/bold]\n\n"
    "[bold]scene-attack campaign run - --out out/x < campaign.json[/bold]"
)
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
    from scene_attack.cli.campaigns import CampaignLine, results
    from scene_attack.cli.commands.run import keep_memory, library
    from scene_attack.cli.result_folder import prepare_folder
    from scene_attack.cli.specs import read_campaign
    from scene_attack.runs.campaign_plan import nothing_chosen
    from scene_attack.runs.check import check_size
    from scene_attack.runs.environment import options_to_run
    from scene_attack.scenes.furniture import slugify

    options = options_to_run()
    keep_memory()
    report_plugins()
    campaign = read_campaign(spec, options)
    check_size(campaign)
    folder = out or Path("out") / (slugify(campaign.name) or "campaign")
    prepare_folder(folder)
    assets = library(options)
    from scene_attack.runs.campaign_plan import write
    from scene_attack.runs.campaign_run import run_campaign
    from scene_attack.runs.check import check_samples
    from scene_attack.runs.prepare import prepare

    check_samples(campaign, lambda job: prepare(job, assets))
    try:
        with CampaignLine(campaign.name) as line:
            record = run_campaign(campaign, folder, assets, progress=line.update)
    except KeyboardInterrupt:
        remark("Interrupted; the same command goes on with what is left.")
        raise
    try:
        write(record, folder)
    except MissingExtra as error:
        remark(f"left out: {error.detail}")
    print_found(record, results(record.table), as_json)
    chosen = sum(view.chosen for view in record.views)
    remark(f"{chosen} of {len(record.views)} views attacked. Files in {folder}")
    if why := nothing_chosen(record.views):
        remark(why)


@app.command(epilog="Example: [bold]scene-attack campaign submit examples/campaign-small.json[/bold]")
def submit(
    spec: SpecArgument,
    url: UrlOption = DEFAULT_URL,
    priority: PriorityOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a campaign at a running service."""
    from scene_attack.cli import specs
    from scene_attack.cli.specs import folder_of
    from scene_attack.client import operations
    from scene_attack.client.client import Client
    from scene_attack.client.meshes import sent

    data = specs.read(spec)
    with Client(url) as client:
        request = partial(operations.submit_campaign, priority=priority)
        created = sent(data, folder_of(spec), client.call, request, remark)
        print_found(created, f"{created.id}  {client.url}/campaigns/{created.id}", as_json)


@app.command("list", epilog="Example: [bold]scene-attack campaign list[/bold]")
def list_campaigns(
    url: UrlOption = DEFAULT_URL,
    limit: Annotated[int, typer.Option(min=1, max=100, help="Largest number of campaigns to list.")] = 20,
    as_json: JsonOption = False,
) -> None:
    """List campaigns, newest first."""
    from scene_attack.cli.campaigns import campaign_state
    from scene_attack.client import operations
    from scene_attack.client.client import Client

    with Client(url) as client:
        page = client.call(operations.list_campaigns(limit=limit))
    if as_json:
        print_json(page)
        return
    rows: list[list[str | Text]] = []
    for campaign in page.items:
        far = campaign.progress
        rows.append(
            [
                campaign.id[:SHORT],
                campaign.name,
                campaign_state(campaign.state),
                f"{far.answered}/{far.views}",
                f"{far.ended}/{far.jobs}",
                f"{campaign.created:%Y-%m-%d %H:%M:%S}",
            ]
        )
    say(FittedTable(("id", "name", "state", "views>", "jobs>", "created (UTC)"), rows))


@app.command(epilog="Example: [bold]scene-attack campaign show 0f3c…[/bold]")
def show(campaign_id: CampaignId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Show one campaign: its progress, its outcomes so far and the time left."""
    from scene_attack.client import operations

    _print(operations.get_campaign, campaign_id, url, as_json)


@app.command(epilog="Example: [bold]scene-attack campaign pause 0f3c…[/bold]")
def pause(campaign_id: CampaignId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Hold a campaign's queued jobs back. Jobs that run go on to their end."""
    from scene_attack.client import operations

    _print(operations.pause_campaign, campaign_id, url, as_json)


@app.command(epilog="Example: [bold]scene-attack campaign resume 0f3c…[/bold]")
def resume(campaign_id: CampaignId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Let a paused campaign go on."""
    from scene_attack.client import operations

    _print(operations.resume_campaign, campaign_id, url, as_json)


@app.command(epilog="Example: [bold]scene-attack campaign cancel 0f3c…[/bold]")
def cancel(campaign_id: CampaignId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """End a campaign and its jobs; the results so far stay."""
    from scene_attack.client import operations

    _print(operations.cancel_campaign, campaign_id, url, as_json)


@app.command(
    epilog="Examples: [bold]scene-attack campaign table 0f3c…[/bold]\n\n"
    "[bold]scene-attack campaign table 0f3c… --out out/table[/bold]"
)
def table(
    campaign_id: CampaignId,
    url: UrlOption = DEFAULT_URL,
    to: Annotated[
        Path | None, typer.Option("--out", help="Directory for table.json, table.csv, table.tex and curves.png.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Print the table of a campaign, of the jobs that have ended, or write it with its curves."""
    from scene_attack.cli.campaigns import results
    from scene_attack.client import operations

    result = _call(operations.get_campaign_table, campaign_id, url)
    print_found(result, results(result.table), as_json)
    if to is not None:
        from scene_attack.runs.campaign_plan import write

        remark(*map(str, write(result, to)))


@app.command(
    epilog="Examples: [bold]scene-attack campaign export out/small --maite out/adversaries[/bold]\n\n"
    "[bold]scene-attack campaign export 0f3c… --maite out/adversaries[/bold]"
)
def export(
    source: Annotated[str, typer.Argument(help="The folder of `campaign run`, or the id of a service's campaign.")],
    maite: Annotated[Path, typer.Option(help="Directory of the dataset.")],
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Export the adversaries of a campaign as a MAITE dataset: images, labels and metadata."""
    from scene_attack.cli.campaigns import folder_results, service_results
    from scene_attack.runs.adversary_dataset import export as write

    if Path(source).is_dir():
        count = write(folder_results(Path(source)), maite, name=Path(source).resolve().name)
    elif not re.fullmatch("[0-9a-f]{1,32}", source):
        raise InvalidRequest("source", f"there is no folder {source}, and a campaign's id has 32 hexadecimal digits")
    else:
        from scene_attack.client.client import Client

        with Client(url) as client:
            source = whole_campaign_id(client, source)
            count = write(service_results(client, source), maite, name=source)
    print_found({"folder": str(maite), "adversaries": count}, f"{maite}  {count} adversaries", as_json)


def _call(operation: Callable[[str], Request[Answer]], campaign_id: str, url: str) -> Answer:
    from scene_attack.client.client import Client

    with Client(url) as client:
        return client.call(operation(whole_campaign_id(client, campaign_id)))


def _print(operation: Callable[[str], Request[CampaignView]], campaign_id: str, url: str, as_json: bool) -> None:
    """Prints the campaign as an operation on it leaves it."""
    from scene_attack.cli.campaigns import campaign_state, duration

    campaign = _call(operation, campaign_id, url)
    far = campaign.progress
    row: list[str | Text] = [
        campaign.id,
        campaign.name,
        campaign_state(campaign.state),
        f"{far.answered}/{far.views}",
        str(campaign.chosen),
        f"{far.ended}/{far.jobs}",
        ", ".join(f"{count} {outcome}" for outcome, count in campaign.outcomes.items()),
        str(campaign.reused or ""),
        "" if campaign.ended else duration(campaign.seconds_left),
    ]
    columns = ("id", "name", "state", "views>", "chosen>", "jobs>", "outcomes", "reused>", "time left>")
    print_found(campaign, FittedTable(columns, [row]), as_json)
    if campaign.failure is not None:
        remark(f"paused by the service: {campaign.failure}")
