"""The commands that take one job and this machine: `run`, `replay`, `plan` and `render`, without a service."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scene_attack.cli.commands.options import JsonOption, SeedOption, SpecArgument
from scene_attack.cli.console import (
    FittedTable,
    answer_text,
    err,
    print_found,
    print_json,
    remark,
    report_plugins,
    say,
    yes,
)
from scene_attack.text import small

if TYPE_CHECKING:
    from rich.text import Text

    from scene_attack.cli.progress import JobLine
    from scene_attack.options import Options
    from scene_attack.runs.execute import Progress
    from scene_attack.runs.result import PlannedCost, Result
    from scene_attack.runs.spec import JobSpec
    from scene_attack.scenes.library import Library


app = typer.Typer()


@app.command(
    epilog="Examples: [bold]scene-attack run examples/torch-combined.json --out out/combined[/bold]\n\n"
    "[bold]scene-attack run - --out out/x < spec.json[/bold]"
)
def run(
    spec: SpecArgument,
    out: Annotated[Path, typer.Option(help="Directory for result.json, the perturbation and the images.")],
    seed: SeedOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run one job without a service, and write its files.

    If it is interrupted, the same command resumes it. The exit code is 0 if the job ran to its end, whether the network
    was fooled or held. A directory that holds the result of another job is refused.
    """
    from scene_attack.cli.progress import JobLine
    from scene_attack.cli.result_folder import check_free, prepare_folder
    from scene_attack.cli.specs import local_library, read_job
    from scene_attack.cli.tables import (
        COLUMNS,
        cells,
        goal_line,
        print_analyses,
        print_subsets,
        print_tasks,
    )
    from scene_attack.runs.environment import options_to_run
    from scene_attack.runs.spec import attack_name, job_name

    options = options_to_run()
    keep_memory()
    report_plugins()
    job = read_job(spec, options, seed)
    check_free(out, job)
    prepare_folder(out)
    words = job.model_dump(mode="json")
    titles = local_library(options).titles(thing.mesh for thing in job.scene.objects)
    name, attack = job_name(words, titles), attack_name(words)
    try:
        with JobLine(f"{name}, {attack}") as line:
            result = _execute(job, out, options, line)
    except KeyboardInterrupt:
        remark("Interrupted; the same command goes on from the last checkpoint.")
        raise
    if as_json:
        print_json(result)
        return
    from scene_attack.runs.result import Outcome, outcome

    shown = Outcome.model_validate(outcome(result))
    say(FittedTable(COLUMNS, [cells(name, attack, shown)]))
    if line_of_goal := goal_line(result.spec):
        say(line_of_goal)
    say(*result.findings)
    print_tasks(result.tasks, out)
    print_subsets(result.subsets, result.attribution)
    print_analyses(result.analyses)
    remark(*(f"Shown: {credit}" for credit in result.provenance.credits), f"Files in {out}")


def _execute(spec: "JobSpec", out: Path, options: "Options", line: "JobLine") -> "Result":
    """Runs the job; a checkpoint in `out` is resumed from if it is of this very job, and removed at the end."""
    from scene_attack.cli.tables import warn
    from scene_attack.errors import InvalidRequest
    from scene_attack.runs.execute import execute

    def report(progress: "Progress") -> None:
        row = None if progress.row is None else progress.row.model_dump()
        line.update(progress.analysis or progress.phase, progress.step, progress.steps, row)

    checkpoint, begun = out / "checkpoint", out / "checkpoint.json"
    words = spec.model_dump_json()
    if not (begun.exists() and begun.read_text("utf-8") == words):
        checkpoint.unlink(missing_ok=True)
        begun.write_text(words, "utf-8")
    try:
        result = execute(
            spec,
            out,
            library(options),
            progress=report,
            checkpoint=checkpoint,
            checked=lambda _, warnings: warn(warnings),
        )
    except InvalidRequest:
        begun.unlink()
        raise
    checkpoint.unlink(missing_ok=True)
    begun.unlink(missing_ok=True)
    return result


def keep_memory() -> None:
    """Starts this process again with the allocator settings of a worker; they are read at start only."""
    import os
    import sys

    from scene_attack.process import ALLOCATOR, program

    if not ALLOCATOR.keys() <= os.environ.keys():
        os.execve(sys.executable, program("scene_attack", *sys.argv[1:]), os.environ | ALLOCATOR)


def library(options: "Options") -> "Library":
    """Meshes and maps of this machine, and torch with as many threads as the options say."""
    import gc

    gc.disable()  # importing torch makes objects by the hundred thousand, all to stay; looking for garbage takes 0.3 s
    import torch

    gc.freeze()
    gc.enable()
    from scene_attack.cli.specs import local_library

    torch.set_num_threads(options.threads)
    return local_library(options)


@app.command(epilog="Example: [bold]scene-attack replay out/combined[/bold]")
def replay(
    directory: Annotated[Path, typer.Argument(help="The directory that `run --out` or `export` wrote.")],
    as_json: JsonOption = False,
) -> None:
    """Render the original and the perturbed scene again, and compare them with what is stored.

    Compared are both images, the network's answers to them, p, and whether the goal is met. The exit code is 0 if both
    labels agree and, on the same backend, nothing differs; otherwise it is 1.
    """
    from scene_attack.cli.result_folder import check_finished
    from scene_attack.runs.environment import options_to_run

    options = options_to_run()
    check_finished(directory)
    with err().status("rendering"):
        from scene_attack.runs.replay import replay as render_again

        again = render_again(directory, library(options), options)
    row: list[str | Text] = [
        answer_text(again.stored),
        answer_text(again.replayed),
        yes(again.fooled),
        f"{again.pixels_differing:,}",
        ", ".join(again.differs) or "nothing",
        yes(again.same_backend),
        yes(again.reproduced),
    ]
    columns = ("stored", "rendered again", "goal met", "pixels differing>", "differs", "same backend", "reproduced")
    print_found(again.model_dump(mode="json"), FittedTable(columns, [row]), as_json)
    if not again.reproduced:
        raise typer.Exit(1)


def _read(spec: str) -> "tuple[Options, JobSpec]":
    """The options by which this process is set up, and the job in a file. Names the plug-ins that were left out."""
    from scene_attack.cli.specs import read_job
    from scene_attack.runs.environment import options_to_run

    options = options_to_run()
    report_plugins()
    return options, read_job(spec, options)


@app.command(epilog="Example: [bold]scene-attack plan examples/torch-combined.json[/bold]")
def plan(
    spec: SpecArgument,
    as_json: JsonOption = False,
) -> None:
    """Print how a job's images would be rendered: the parts kept, those left out and why, the estimated error, and
    what the attack costs.

    Of a question about the image it prints the program, the right answer and what limits the search. The command runs
    no attack; it draws the scene, asks the network twice, and measures errors of images and gradients. A job that
    cannot run ends with the same error as in `run`.
    """
    options, job = _read(spec)
    with err().status("loading") as line:
        assets = library(options)
        from scene_attack.runs.preview import planned_cost

        line.update("planning")
        planned = planned_cost(job, assets)
    if as_json:
        print_json(planned)
    else:
        _print_plan(planned)


def _print_plan(planned: "PlannedCost") -> None:
    from scene_attack.cli.tables import print_tasks

    about, cost = planned.plan, planned.cost
    height, width = about.size
    limit = "" if cost.queries is None else f", at most {cost.queries:,} queries"
    say(
        f"{about.renderer}: {', '.join(about.groups)}, {width}×{height} pixels; tolerance {small(about.tolerance)}, "
        f"estimated error {small(about.error)} of displayed values in [0,1] "
        + ("(their maximum)" if about.error_is == "maximum" else "(their mean over covered pixels)"),
        f"up to {cost.steps:,} steps{limit}; an image takes {1000 * cost.image_seconds:.3g} ms and a query "
        f"{1000 * cost.query_seconds:.3g} ms, so at least {cost.least_seconds:.2g} s in all, and gradients besides",
    )
    print_tasks(about.tasks)
    kept = [[f"{i.part} {i.what}".strip(), f"{i.kept:,}", f"{i.of:,}", i.why, small(i.error)] for i in about.items]
    say(FittedTable(("item", "kept>", "of>", "why the others are left out", "error>"), kept))
    done = [
        [f"{s.part} {s.name}".strip(), s.method, s.when, f"{s.evaluations:,} {s.unit}", s.why, small(s.error)]
        for s in about.stages
    ]
    if done:
        say(FittedTable(("stage", "method", "when", "work>", "why", "error>"), done))
    if about.gradients:
        rows = [
            [f"{g.part} {g.group}".strip(), small(g.relative), f"{100 * g.wrong_signs:.2g} %"] for g in about.gradients
        ]
        say(FittedTable(("gradient", "relative error>", "wrong signs>"), rows))
    if about.environment_map_error is not None:
        say(
            f"environment map's resolution: error {small(about.environment_map_error)} against 64×128 texels, not part "
            "of the estimated error"
        )


@app.command(epilog="Example: [bold]scene-attack render examples/torch-combined.json --out picture.png[/bold]")
def render(
    spec: SpecArgument,
    out: Annotated[Path | None, typer.Option(help="Write the image to this PNG file.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Render a job's scene and ask the network, without an attack: the image and the first five answers.

    It is what POST /v1/preview answers. A job that cannot run ends with the same error as in `run`.
    """
    from scene_attack.cli.tables import warn
    from scene_attack.errors import InvalidRequest

    options, job = _read(spec)
    if out is not None and not out.parent.is_dir():
        raise InvalidRequest("--out", f"there is no folder {out.parent}; make it first")
    with err().status("loading") as line:
        assets = library(options)
        from scene_attack.analysis.images import save_png
        from scene_attack.runs.preview import preview

        line.update("rendering")
        shown, image = preview(job, assets)
    if out is not None:
        save_png(image, out)
    if as_json:
        print_json(shown)
        return
    for first in shown.answers:
        rows = [[label, f"{probability:.3f}"] for label, probability in first.answer.top]
        say(FittedTable(("answer", "probability>"), rows, title=first.asked))
    warn(shown.warnings)
    if out is not None:
        remark(f"Image in {out}")
