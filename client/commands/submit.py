"""The command `submit`, which queues a job at a service, and functions that follow and show a job."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from client.commands.options import DEFAULT_URL, JsonOption, PriorityOption, SeedOption, UrlOption

if TYPE_CHECKING:
    from client.api_client import ApiClient


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
    from client import spec_input
    from client.api_client import ApiClient
    from client.console import err, out, print_json
    from client.local_meshes import folder_of, sent
    from client.outcomes import warn

    data = spec_input.read(spec, seed)
    with ApiClient(url) as client:
        job = sent(data, folder_of(spec), client, lambda request: client.submit_job(request, priority))
        warn(job.get("warnings", ()))
        if not job.get("checked", True):
            err().print("accepted before its check had ended; a worker checks it first")
        if watch:
            err().print(f"{client.url}/jobs/{job['id']}", markup=False, highlight=False)
            job = follow(client, job)
        if as_json:
            print_json(job)
        elif watch:
            show(job)
        else:
            out().print(f"{job['id']}  {client.url}/jobs/{job['id']}", markup=False, highlight=False)
    if watch and job["state"] != "succeeded":
        raise typer.Exit(2 if job["state"] == "rejected" else 1)


def follow(client: "ApiClient", job: dict[str, Any]) -> dict[str, Any]:
    """Shows the job's progress until it has ended; returns the finished job. Ctrl-C ends the showing, not the job."""
    from client.console import err
    from client.live import JobLine

    try:
        with JobLine(f"{job['name']}, {job['attack']}") as line:
            for event in client.stream_job_events(job["id"]):
                if event.kind == "progress":
                    rows = event.data["rows"]
                    last = rows[-1] if rows else None
                    line.update(event.data["phase"], event.data["step"], event.data["steps"], last)
    except KeyboardInterrupt:
        said = f"The job goes on. `scene-attack jobs watch {job['id']}` follows it, `jobs cancel` ends it."
        err().print(said, markup=False, highlight=False, soft_wrap=True)
        raise
    return client.get_job(job["id"])


def show(job: dict[str, Any]) -> None:
    """Prints a job: its outcome if it succeeded, otherwise its state and the reason for a failure; then what people
    said of it.
    """
    from client.console import err, out, state_text, table
    from client.outcomes import COLUMNS, SPARE, cells
    from client.question_tables import print_answered
    from services.pipeline.question_record import QuestionResult

    scene, attack = job.get("title") or job["name"], job["attack"]
    if job.get("outcome"):
        out().print(table(COLUMNS, [cells(scene, attack, job["outcome"])], spare=SPARE))
        print_answered([QuestionResult.model_validate(one) for one in job["result"].get("questions", ())])
        return _say(job)
    out().print(table(("id", "state", "scene", "attack"), [[job["id"], state_text(job["state"]), scene, attack]]))
    if job.get("waiting"):
        err().print(f"waits: {job['waiting']}", markup=False, highlight=False)
    for error in job.get("errors", ()):
        err().print(f"rejected: {error['field']}: {error['detail']}", markup=False, highlight=False)
    if job.get("failure"):
        err().print(f"failed ({job['failure']['kind']}): {job['failure']['detail']}", markup=False, highlight=False)
    return _say(job)


def _say(job: dict[str, Any]) -> None:
    from client.console import out

    if job.get("tags"):
        out().print(f"tags: {' '.join(job['tags'])}", markup=False, highlight=False)
    if job.get("note"):
        out().print(f"note: {job['note']}", markup=False, highlight=False)
