"""The command `plan`: prints the plan of a job without running it."""

from typing import TYPE_CHECKING, Annotated

import typer

from client.commands.options import JsonOption

if TYPE_CHECKING:
    from services.pipeline.job_plan import JobPlan


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(epilog="Example: [bold]scene-attack plan examples/torch-combined.json[/bold]")(plan)


def plan(
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="A job as JSON; - reads it from stdin.")],
    as_json: JsonOption = False,
) -> None:
    """Print how a job's images would be rendered: the parts kept, those left out and why, and the estimated error.

    Of a question about the image it prints the program, the right answer and what limits the search. The command runs
    no attack; it rasterises the scene, asks the network once, and measures errors of images and gradients. A job that
    cannot run ends with the same error as in `run`.
    """
    from client.console import err, print_json, report_extensions
    from client.local_meshes import read_job
    from client.settings import settings_to_run

    settings = settings_to_run()
    report_extensions()
    job = read_job(spec, settings)
    with err().status("loading") as line:
        from client.commands.run import library

        assets = library(settings)
        from services.pipeline.prepare import plan as compile_plan

        line.update("planning")
        found = compile_plan(job, assets)
    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        _print(found)


def _print(found: "JobPlan") -> None:
    from client.console import out, small, table
    from client.question_tables import print_asked

    height, width = found.size
    out().print(
        f"{found.renderer}: {', '.join(found.groups)}, {width}×{height} pixels; tolerance {small(found.tolerance)}, "
        f"estimated error {small(found.error)} of displayed values in [0,1] "
        + ("(their maximum)" if found.error_is == "maximum" else "(their mean over covered pixels)"),
        highlight=False,
    )
    print_asked(found.questions)
    kept = [[f"{i.part} {i.what}".strip(), f"{i.kept:,}", f"{i.of:,}", i.why, small(i.error)] for i in found.items]
    out().print(table(("item", "kept>", "of>", "why the others are left out", "error>"), kept))
    done = [
        [f"{s.part} {s.name}".strip(), s.method, s.when, f"{s.evaluations:,} {s.unit}", s.why, small(s.error)]
        for s in found.stages
    ]
    if done:
        out().print(table(("stage", "method", "when", "work>", "why", "error>"), done))
    if found.gradients:
        rows = [
            [f"{g.part} {g.group}".strip(), small(g.relative), f"{100 * g.wrong_signs:.2g} %"] for g in found.gradients
        ]
        out().print(table(("gradient", "relative error>", "wrong signs>"), rows))
    if found.environment_map_error is not None:
        out().print(
            f"environment map's resolution: error {small(found.environment_map_error)} against 64×128 texels, not part "
            "of the estimated error",
            highlight=False,
        )
