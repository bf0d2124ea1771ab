"""The commands `submit`, which queues a job at a service, and `jobs`: list, show, follow, name, repeat, continue,
cancel, delete and download the jobs of a service.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from scene_attack.cli.commands.options import (
    SHORT,
    JsonOption,
    PriorityOption,
    SeedOption,
    SpecArgument,
    UrlOption,
    whole_campaign_id,
    whole_job_id,
)
from scene_attack.cli.console import FittedTable, print_found, print_json, remark, say, state_text
from scene_attack.client import DEFAULT_URL

if TYPE_CHECKING:
    from rich.text import Text

    from scene_attack.client.client import Job
    from scene_attack.client.operations import Answer, Request, StateName
    from scene_attack.client.schemas import JobView


app = typer.Typer(
    help="List, show, follow, name, repeat, continue, cancel and download the jobs of a running service.",
    no_args_is_help=True,
)


submitting = typer.Typer()


JobId = Annotated[
    str, typer.Argument(metavar="ID", help="The id that `submit` printed, or as much of its beginning as no other has.")
]


@submitting.command(
    epilog="Examples: [bold]scene-attack submit examples/image-fgsm.json --watch[/bold]\n\n"
    "[bold]scene-attack submit - --url http://10.0.0.7:8008 < spec.json[/bold]"
)
def submit(
    spec: SpecArgument,
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
    from scene_attack.cli import specs
    from scene_attack.cli.specs import folder_of
    from scene_attack.cli.tables import warn
    from scene_attack.client.client import Client

    data = specs.read(spec, seed)
    with Client(url) as client:
        submitted = client.submit(data, folder=folder_of(spec), say=remark, priority=priority)
        job = submitted.data
        warn(job.warnings)
        if not job.checked:
            remark("accepted before its check had ended; a worker checks it first")
        page = f"{client.url}/jobs/{job.id}"
        if watch:
            remark(page)
            job = follow(submitted)
            print_job(job, as_json)
        else:
            print_found(job, f"{job.id}  {page}", as_json)
    if watch and job.state != "succeeded":
        raise typer.Exit(2 if job.state == "rejected" else 1)


def follow(job: Job) -> JobView:
    """Shows the job's progress until it has ended; returns the finished job. Ctrl-C ends the showing, not the job."""
    from scene_attack.cli.progress import JobLine

    try:
        with JobLine(f"{job.data.name}, {job.data.attack}") as line:
            for event in job.watch():
                if event.kind == "progress":
                    rows = event.data["rows"]
                    last = rows[-1] if rows else None
                    line.update(event.data["phase"], event.data["step"], event.data["steps"], last)
    except KeyboardInterrupt:
        remark(f"The job goes on. `scene-attack jobs watch {job.id}` follows it, `jobs cancel` ends it.")
        raise
    return job.data


def print_job(job: JobView, as_json: bool) -> None:
    """Prints a job: its outcome if it succeeded, otherwise its state and the reason for a failure; then what people
    said of it.
    """
    if as_json:
        print_json(job)
        return
    from scene_attack.cli.tables import COLUMNS, SPARE, cells, print_tasks
    from scene_attack.runs.result import Result

    scene = job.title or job.name
    if job.outcome is not None:
        say(FittedTable(COLUMNS, [cells(scene, job.attack, job.outcome)], spare=SPARE))
        if isinstance(job.result, Result):
            say(*job.result.findings)
            print_tasks(job.result.tasks)
    else:
        row: list[str | Text] = [job.id, state_text(job.state), scene, job.attack]
        say(FittedTable(("id", "state", "scene", "attack"), [row]))
    messages = [f"waits: {job.waiting}"] if job.waiting else []
    messages += [f"rejected: {error.field}: {error.detail}" for error in job.errors]
    messages += [f"failed ({job.failure.kind}): {job.failure.detail}"] if job.failure else []
    remark(*messages)
    if job.tags:
        say(f"tags: {' '.join(job.tags)}")
    if job.note:
        say(f"note: {job.note}")


@app.command(
    "list",
    epilog="Examples: [bold]scene-attack jobs list[/bold]\n\n"
    "[bold]scene-attack jobs list --state failed --all[/bold]\n\n"
    "[bold]scene-attack jobs list -q 'piano verified p<5e-3' --sort p --limit 500[/bold]",
)
def list_jobs(
    url: UrlOption = DEFAULT_URL,
    state: Annotated[
        str | None,
        typer.Option(
            help="List only jobs in this state, or in one of these, as running,queued: queued, running, cancelling, "
            "succeeded, failed, rejected or cancelled."
        ),
    ] = None,
    query: Annotated[
        str | None,
        typer.Option(
            "--query", "-q", help="List only jobs that meet a query: scene:piano renderer:torch verified p<5e-3."
        ),
    ] = None,
    campaign: Annotated[
        str | None, typer.Option(help="List only the jobs of the campaign with this id, or its beginning.")
    ] = None,
    sort: Annotated[
        str,
        typer.Option(
            help="Sort by created, ended, name, scene, renderer, method, target, state, outcome, verified, p, queries "
            "or seconds; with - before it the greatest first."
        ),
    ] = "-created",
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, help="Largest number of jobs to list.")] = 20,
    whole: Annotated[bool, typer.Option("--all", "-a", help="List all jobs, whatever their number.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the jobs that meet a query, newest first or in another order.

    A queued job that no live worker can run says why it waits.
    """
    from itertools import islice

    from scene_attack.cli.tables import answer_cell, outcome_cell, verified
    from scene_attack.client.client import Client

    with Client(url) as client:
        about = None if campaign is None else whole_campaign_id(client, campaign)
        states = None if state is None else cast("list[StateName]", [name.strip() for name in state.split(",")])
        matching = client.list_jobs(state=states, campaign=about, q=query, sort=sort)
        jobs = list(matching if whole else islice(matching, limit + 1))
    more = not whole and len(jobs) > limit
    jobs = jobs[:limit] if more else jobs
    if as_json:
        print_json({"items": jobs, "more": more})
        return
    rows: list[list[str | Text]] = []
    for job in jobs:
        state_cell, outcome = state_text(job.state), job.outcome
        if job.waiting:
            state_cell.append(f"\n{job.waiting}", style="dim")
        row: list[str | Text] = [job.id[:SHORT], state_cell, job.name, job.attack, job.target]
        if outcome is None:
            rows.append([*row, "", "", ""])
        else:
            change = f"{answer_cell(outcome, 'before')} → {answer_cell(outcome, 'after')}"
            rows.append([*row, change, outcome_cell(outcome), verified(outcome)])
    columns = ("id", "state", "scene", "attack", "target", "before → after", "network", "verified")
    say(FittedTable(columns, rows, spare=("target", "attack", "verified", "network")))
    if more:
        remark(f"These are the first {limit}; --all lists every job, --limit more of them.")


@app.command(epilog="Example: [bold]scene-attack jobs show 0f3c… --json[/bold]")
def show(job_id: JobId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Show one job: its state, outcome, or the reason it failed."""
    from scene_attack.client import operations

    print_job(_call(operations.get_job, job_id, url), as_json)


@app.command(epilog="Example: [bold]scene-attack jobs watch 0f3c…[/bold]")
def watch(job_id: JobId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Follow a job until it ends. The exit code is 0 when it succeeded."""
    from scene_attack.client.client import Client

    with Client(url) as client:
        job = follow(client.get_job(whole_job_id(client, job_id)))
    print_job(job, as_json)
    if job.state != "succeeded":
        raise typer.Exit(1)


@app.command(epilog="Example: [bold]scene-attack jobs cancel 0f3c…[/bold]")
def cancel(job_id: JobId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Ask a job to stop; a running job stops within one step. A job that has ended stays as it is."""
    from scene_attack.client import operations

    job = _call(operations.cancel_job, job_id, url)
    print_found(job, f"{job.id}  {job.state}", as_json)


@app.command(epilog="Example: [bold]scene-attack jobs retry 0f3c…[/bold]")
def retry(job_id: JobId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Queue the request of a job again, as a new job, and print its id."""
    from scene_attack.client import operations

    job = _call(operations.retry_job, job_id, url)
    print_found(job, job.id, as_json)


@app.command("continue", epilog="Example: [bold]scene-attack jobs continue 0f3c…[/bold]")
def go_on(job_id: JobId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Go on from the checkpoint of a job that was cancelled or failed, as a new job, and print its id."""
    from scene_attack.client import operations

    job = _call(operations.continue_job, job_id, url)
    print_found(job, job.id, as_json)


def _call(operation: Callable[[str], Request[Answer]], job_id: str, url: str) -> Answer:
    from scene_attack.client.client import Client

    with Client(url) as client:
        return client.call(operation(whole_job_id(client, job_id)))


@app.command(epilog="Example: [bold]scene-attack jobs edit 0f3c… --title 'Figure 3' --tag paper[/bold]")
def edit(
    job_id: JobId,
    title: Annotated[str | None, typer.Option(help="Give the job this name; '' for none.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="Add this tag; may be repeated.")] = None,
    untag: Annotated[list[str] | None, typer.Option(help="Take this tag away; may be repeated.")] = None,
    note: Annotated[str | None, typer.Option(help="Write this note about the job; '' for none.")] = None,
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Give a job a title, tags and a note, by which lists find it (`tag:paper`). No result changes."""
    from scene_attack.client import operations
    from scene_attack.client.client import Client

    changes: dict[str, object] = {
        name: value for name, value in (("title", title), ("note", note)) if value is not None
    }
    with Client(url) as client:
        whole = whole_job_id(client, job_id)
        if tag or untag:
            had = client.get_job(whole).data.tags
            changes["tags"] = sorted({*had, *(tag or ())} - {*(untag or ())})
        job = client.call(operations.edit_job(whole, changes))
    print_found(job, " ".join([f"{job.id} ", job.title or job.name, *(f"[{tag}]" for tag in job.tags)]), as_json)


@app.command(epilog="Example: [bold]scene-attack jobs delete 0f3c…[/bold]")
def delete(job_id: JobId, url: UrlOption = DEFAULT_URL, as_json: JsonOption = False) -> None:
    """Delete a job that has ended, with its files."""
    from scene_attack.client import operations
    from scene_attack.client.client import Client

    with Client(url) as client:
        whole = whole_job_id(client, job_id)
        client.call(operations.delete_job(whole))
    print_found({"id": whole, "deleted": True}, f"{whole}  deleted", as_json)


@app.command(epilog="Example: [bold]scene-attack jobs download 0f3c… --out out/piano[/bold]")
def download(
    job_id: JobId,
    to: Annotated[Path, typer.Option("--out", help="Directory for the files.")],
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Download the files of a finished job. `scene-attack replay` can then check the directory.

    A directory that holds the result of another job is refused.
    """
    from scene_attack.cli.result_folder import check_same_files, prepare_folder
    from scene_attack.client import operations
    from scene_attack.client.client import Client

    prepare_folder(to)
    with Client(url) as client:
        whole = whole_job_id(client, job_id)
        artifacts = client.call(operations.list_artifacts(whole)).items
        check_same_files(to, artifacts)
        for artifact in artifacts:
            name = Path(artifact.name).name  # a service can name no file outside the directory
            client.save(operations.download_artifact(whole, artifact.name), to / name)
            if not as_json:
                say(f"{to / name}  {artifact.size:,} bytes")
    if as_json:
        print_json({"id": whole, "files": [str(to / Path(artifact.name).name) for artifact in artifacts]})
