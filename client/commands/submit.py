"""The command `submit`, which queues a job at a service, and functions that follow and show a job."""

from typing import TYPE_CHECKING, Annotated

import typer

from client.commands.options import DEFAULT_URL, JsonOption, PriorityOption, SeedOption, UrlOption

if TYPE_CHECKING:
    from rich.text import Text

    from api.schemas import JobView
    from client.client import Job


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(
        epilog="Examples: [bold]scene-attack submit examples/image-fgsm.json --watch[/bold]\n\n"
        "[bold]scene-attack submit - --url http://10.0.0.7:8008 < spec.json[/bold]"
    )(submit)


def submit(
    spec: Annotated[str, typer.Argument(metavar="SPEC", help="A job as JSON; - reads it from stdin.")],
    url: UrlOption = DEFAULT_URL,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Follow the job until it ends.")] = False,
    seed: SeedOption = None,
    priority: PriorityOption = None,
    as_json: JsonOption = False,
) -> None:
    """Queue a job at a running service.

    With --watch the exit code is 0 if the job succeeded (ran to its end), 2 if it was rejected because its request
    cannot run, and 1 if it failed or was cancelled.
    """
    from client import operations, spec_input
    from client.client import Client, Job
    from client.console import err, out, print_json
    from client.local_meshes import folder_of, sent
    from client.outcomes import warn

    data = spec_input.read(spec, seed)
    with Client(url) as client:
        job = sent(data, folder_of(spec), client, lambda data: operations.submit_job(data, priority=priority))
        warn(job.warnings)
        if not job.checked:
            err().print("accepted before its check had ended; a worker checks it first")
        if watch:
            err().print(f"{client.url}/jobs/{job.id}", markup=False, highlight=False)
            job = follow(Job(job, client))
        if as_json:
            print_json(job)
        elif watch:
            show(job)
        else:
            out().print(f"{job.id}  {client.url}/jobs/{job.id}", markup=False, highlight=False)
    if watch and job.state != "succeeded":
        raise typer.Exit(2 if job.state == "rejected" else 1)


def follow(job: "Job") -> "JobView":
    """Shows the job's progress until it has ended; returns the finished job. Ctrl-C ends the showing, not the job."""
    from client.console import err
    from client.live import JobLine

    try:
        with JobLine(f"{job.data.name}, {job.data.attack}") as line:
            for event in job.watch():
                if event.kind == "progress":
                    rows = event.data["rows"]
                    last = rows[-1] if rows else None
                    line.update(event.data["phase"], event.data["step"], event.data["steps"], last)
    except KeyboardInterrupt:
        words = f"The job goes on. `scene-attack jobs watch {job.id}` follows it, `jobs cancel` ends it."
        err().print(words, markup=False, highlight=False, soft_wrap=True)
        raise
    return job.data


def show(job: "JobView") -> None:
    """Prints a job: its outcome if it succeeded, otherwise its state and the reason for a failure; then what people
    said of it.
    """
    from client.console import err, out, state_text, table
    from client.outcomes import COLUMNS, SPARE, cells
    from client.question_tables import print_answered
    from services.pipeline.result import Result

    scene = job.title or job.name
    if job.outcome is not None:
        out().print(table(COLUMNS, [cells(scene, job.attack, job.outcome)], spare=SPARE))
        if isinstance(job.result, Result):
            print_answered(job.result.questions)
    else:
        row: list[str | Text] = [job.id, state_text(job.state), scene, job.attack]
        out().print(table(("id", "state", "scene", "attack"), [row]))
    messages = [f"waits: {job.waiting}"] if job.waiting else []
    messages += [f"rejected: {error.field}: {error.detail}" for error in job.errors]
    messages += [f"failed ({job.failure.kind}): {job.failure.detail}"] if job.failure else []
    for message in messages:
        err().print(message, markup=False, highlight=False)
    if job.tags:
        out().print(f"tags: {' '.join(job.tags)}", markup=False, highlight=False)
    if job.note:
        out().print(f"note: {job.note}", markup=False, highlight=False)
