"""The commands `run` and `replay`: one job in this process, without a service."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from client.commands.options import JsonOption, SeedOption

if TYPE_CHECKING:
    from rich.text import Text

    from client.live import JobLine
    from services.pipeline.execute import Progress
    from services.pipeline.result import Result
    from services.pipeline.spec import JobSpec
    from services.scenes.library import Library
    from services.settings import Settings


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(
        epilog="Examples: [bold]scene-attack run examples/torch-combined.json --out out/combined[/bold]\n\n"
        "[bold]scene-attack run - --out out/x < spec.json[/bold]"
    )(run)
    app.command(epilog="Example: [bold]scene-attack replay out/combined[/bold]")(replay)


def run(
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="A job as JSON; - reads it from stdin.")],
    out: Annotated[Path, typer.Option(help="Directory for result.json, the perturbation and the images.")],
    seed: SeedOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run one job without a service, and write its files.

    If it is interrupted, the same command resumes it. The exit code is 0 if the job ran to its end, whether the network
    was fooled or held. A directory that holds the result of another job is refused.
    """
    from client.analysis_tables import print_analyses, print_subsets
    from client.console import err, print_json, report_extensions, table
    from client.console import out as stdout
    from client.live import JobLine
    from client.local_meshes import local_library, read_job
    from client.outcomes import COLUMNS, cells, goal_line
    from client.question_tables import print_answered
    from client.result_folder import check_free, prepare_folder
    from client.settings import settings_to_run
    from services.pipeline.names import attack_name, job_name

    settings = settings_to_run()
    keep_memory()
    report_extensions()
    job = read_job(spec, settings, seed)
    check_free(out, job)
    prepare_folder(out)
    words = job.model_dump(mode="json")
    titles = local_library(settings).titles(thing.mesh for thing in job.scene.objects)
    name, attack = job_name(words, titles), attack_name(words)
    try:
        with JobLine(f"{name}, {attack}") as line:
            result = _execute(job, out, settings, line)
    except KeyboardInterrupt:
        err().print("Interrupted; the same command goes on from the last checkpoint.", markup=False, highlight=False)
        raise
    if as_json:
        print_json(result.model_dump(mode="json"))
        return
    from services.pipeline.outcome import Outcome, outcome

    found = Outcome.model_validate(outcome(result))
    stdout().print(table(COLUMNS, [cells(name, attack, found)]))
    if line_of_goal := goal_line(result.spec):
        stdout().print(line_of_goal, markup=False, highlight=False, soft_wrap=True)
    print_answered(result.questions, out)
    print_subsets(result.subsets, result.attribution)
    print_analyses(result.analyses)
    for credit in result.provenance.credits:
        err().print(f"Shown: {credit}", markup=False, highlight=False)
    err().print(f"Files in {out}", markup=False, highlight=False)


def replay(
    directory: Annotated[Path, typer.Argument(help="The directory that `run --out` or `export` wrote.")],
    as_json: JsonOption = False,
) -> None:
    """Render a stored perturbation again and compare label and image with the stored ones.

    The exit code is 0 if the labels agree and, on the same backend, no pixel differs; otherwise it is 1.
    """
    from client.console import answer_text, err, print_json, table, yes
    from client.console import out as stdout
    from client.result_folder import check_finished
    from client.settings import settings_to_run

    settings = settings_to_run()
    check_finished(directory)
    with err().status("rendering"):
        from services.pipeline.replay import replay as render_again

        again = render_again(directory, library(settings), settings)
    same = again.stored.label == again.replayed.label and (again.pixels_differing == 0 or not again.same_backend)
    if as_json:
        print_json(again.model_dump(mode="json") | {"reproduced": same})
    else:
        row: list[str | Text] = [
            answer_text(again.stored),
            answer_text(again.replayed),
            yes(again.fooled),
            f"{again.pixels_differing:,}",
            yes(again.same_backend),
            yes(same),
        ]
        columns = ("stored", "rendered again", "fooled", "pixels differing>", "same backend", "reproduced")
        stdout().print(table(columns, [row]))
    if not same:
        raise typer.Exit(1)


def keep_memory() -> None:
    """Starts this process again with the allocator settings of a worker; they are read at start only."""
    import os
    import sys

    from services.jobs.child import ALLOCATOR

    if not ALLOCATOR.keys() <= os.environ.keys():
        os.execve(sys.executable, [sys.executable, "-m", "client", *sys.argv[1:]], os.environ | ALLOCATOR)


def library(settings: "Settings") -> "Library":
    """Meshes and maps of this machine, and torch with as many threads as the settings say."""
    import gc

    gc.disable()  # importing torch makes objects by the hundred thousand, all to stay; looking for garbage takes 0.3 s
    import torch

    gc.freeze()
    gc.enable()
    from client.local_meshes import local_library

    torch.set_num_threads(settings.threads)
    return local_library(settings)


def _execute(spec: "JobSpec", out: Path, settings: "Settings", line: "JobLine") -> "Result":
    """Runs the job; a checkpoint in `out` is resumed from if it is of this very job, and removed at the end."""
    from client.outcomes import warn
    from services.errors import InvalidRequest
    from services.pipeline.execute import execute

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
            library(settings),
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
