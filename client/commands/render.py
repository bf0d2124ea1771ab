"""The command `render`: the image of a job's scene and the network's first answers, without an attack."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from client.commands.options import JsonOption

if TYPE_CHECKING:
    from services.pipeline.preview_record import PlannedCost, Preview


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(epilog="Example: [bold]scene-attack render examples/torch-combined.json --out picture.png[/bold]")(
        render
    )


def render(
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="A job as JSON; - reads it from stdin.")],
    out: Annotated[Path | None, typer.Option(help="Write the image to this PNG file.")] = None,
    plan: Annotated[bool, typer.Option("--plan", help="Make the plan, too, and state what the attack costs.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Render a job's scene and ask the network, without an attack: the image and the first five answers.

    It is what POST /v1/preview answers. A job that cannot run ends with the same error as in `run`.
    """
    from client.commands.run import library
    from client.console import err, print_json, report_extensions
    from client.local_meshes import read_job
    from client.settings import settings_to_run
    from services.errors import InvalidRequest

    settings = settings_to_run()
    report_extensions()
    job = read_job(spec, settings)
    if out is not None and not out.parent.is_dir():
        raise InvalidRequest("--out", f"there is no folder {out.parent}; make it first")
    with err().status("loading") as line:
        assets = library(settings)
        from services.analysis.images import save_png
        from services.pipeline.preview import planned_cost, preview

        line.update("rendering")
        shown, image = preview(job, assets)
        planned = None
        if plan:
            line.update("planning")
            planned = planned_cost(job, assets)
    if out is not None:
        save_png(image, out)
    if as_json:
        print_json(shown.model_dump(mode="json") | ({} if planned is None else planned.model_dump(mode="json")))
    else:
        _print_answers(shown)
        if planned is not None:
            _print_cost(planned)
        if out is not None:
            err().print(f"Image in {out}", markup=False, highlight=False)


def _print_answers(shown: "Preview") -> None:
    from client.console import err, out, table

    for one in shown.answers:
        rows = [[label, f"{probability:.3f}"] for label, probability in one.answer.top]
        out().print(table(("answer", "probability>"), rows, title=one.question))
    for warning in shown.warnings:
        err().print(f"warning: {warning.field}: {warning.text}", markup=False, highlight=False)


def _print_cost(planned: "PlannedCost") -> None:
    from client.console import out, small

    plan, cost = planned.plan, planned.cost
    height, width = plan.size
    limit = "" if cost.queries is None else f", at most {cost.queries:,} queries"
    lines = (
        f"{plan.renderer}: {', '.join(plan.groups)}, {width}×{height} pixels; estimated error {small(plan.error)}",
        f"up to {cost.steps:,} steps{limit}; an image takes {1000 * cost.image_seconds:.3g} ms and a query "
        f"{1000 * cost.query_seconds:.3g} ms, so at least {cost.least_seconds:.2g} s in all, and gradients besides",
    )
    for line in lines:
        out().print(line, markup=False, highlight=False, soft_wrap=True)
