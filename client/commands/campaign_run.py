"""The command `campaign run`: a campaign in this process, without a service."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import JsonOption

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
    from client.campaign_live import CampaignLine
    from client.campaign_tables import results
    from client.commands.run import keep_memory, library
    from client.console import err, print_json, report_extensions
    from client.console import out as stdout
    from client.local_meshes import read_campaign
    from client.result_folder import prepare_folder
    from client.settings import settings_to_run
    from services.pipeline.campaign_check import check_size
    from services.pipeline.campaign_select import nothing_chosen
    from services.scenes.catalogue import slugify

    settings = settings_to_run()
    keep_memory()
    report_extensions()
    campaign = read_campaign(spec, settings)
    check_size(campaign, settings.max_campaign_jobs)
    folder = out or Path("out") / (slugify(campaign.name) or "campaign")
    prepare_folder(folder)
    assets = library(settings)
    from services.pipeline.campaign_check import check_samples
    from services.pipeline.campaign_result import write
    from services.pipeline.campaign_run import run_campaign
    from services.pipeline.prepare import preflight

    check_samples(campaign, lambda job: preflight(job, assets))
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
    if why := nothing_chosen(found.views):
        err().print(why, markup=False, highlight=False, soft_wrap=True)
