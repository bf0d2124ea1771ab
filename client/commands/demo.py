"""`demo`: the service, attacking furniture and the answer to a question."""

from contextlib import suppress
from time import sleep
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from api.schemas import JobView
    from client.client import Client
    from client.fitted_table import FittedTable

LOOK_EVERY = 0.5
"""Seconds between two looks at the jobs."""


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(epilog="Example: [bold]scene-attack demo --once[/bold]")(demo)


def demo(
    once: Annotated[bool, typer.Option("--once", help="End when the jobs have ended.")] = False,
) -> None:
    """Start the service, attack furniture and the answer to a question through its HTTP API, and show the outcome.

    Three things the network gets right, each attacked in image space, through the differentiable renderer and through
    the physical parameters of the other renderer; and a question about a scene of solids, through the differentiable
    renderer. An attack that does not fool the network is shown as held.

    The exit code is 0 if all jobs ran to their end.
    """
    from client.client import Client
    from client.console import err, out
    from client.demo_jobs import specs
    from client.outcomes import successes
    from client.service_process import running_service
    from client.settings import settings_to_run

    values, say = settings_to_run(), err()
    data = values.data_dir / "demo"
    say.print("starting the service: networks and OpenGL are loaded once")
    with running_service(data, {"SCENE_ATTACK_PORT": str(_free_port(values.host, values.port))}) as (url, process):
        say.print(f"service at {url}, its log in {data / 'service.log'}", markup=False, highlight=False)
        with Client(url) as client:
            _clear(client)
            jobs = _watch(client, [client.submit_job(spec).id for spec in specs()])
        out().print(_table(jobs))
        out().print(successes(job.outcome for job in jobs if job.outcome is not None), highlight=False)
        for job in jobs:
            if job.failure is not None:
                say.print(f"{_name(job)} failed: {job.failure.detail}", markup=False, highlight=False)
        out().print(f"Dashboard: {url}", markup=False, highlight=False)
        if not once:
            say.print("It stays up; Ctrl-C ends it.")
            with suppress(KeyboardInterrupt):
                process.wait()
    if any(job.state != "succeeded" for job in jobs):
        raise typer.Exit(1)


def _clear(client: "Client") -> None:
    """Cancels what a demonstration that was broken off has left behind."""
    from client import operations

    for job in client.list_jobs(state=("queued", "running")):
        client.call(operations.cancel_job(job.id))


def _watch(client: "Client", ids: list[str]) -> list["JobView"]:
    """Shows the jobs until all have ended; returns them in the order of `ids`."""
    from rich.live import Live

    from client.console import err

    console, told = err(), dict.fromkeys(ids, "")
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while True:
            jobs = [client.get_job(job_id).data for job_id in ids]
            if console.is_terminal:
                live.update(_table(jobs), refresh=True)
            else:
                for job in jobs:
                    if told[job.id] != job.state:
                        told[job.id] = job.state
                        console.print(f"{_name(job)}: {job.state}", markup=False, highlight=False)
            if all(job.state.terminal for job in jobs):
                return jobs
            sleep(LOOK_EVERY)


def _table(jobs: list["JobView"]) -> "FittedTable":
    from client.console import state_text, table
    from client.outcomes import COLUMNS, SPARE, cells

    rows = []
    for job in jobs:
        if job.outcome is not None:
            rows.append([*cells(job.name, job.attack, job.outcome)])
        else:
            state = state_text(job.state)
            if job.state == "running" and job.progress:
                state.append(f" {job.progress.step}/{job.progress.steps}")
            rows.append([job.name, job.attack, state, *[""] * (len(COLUMNS) - 3)])
    return table(COLUMNS, rows, spare=SPARE)


def _name(job: "JobView") -> str:
    return f"{job.name}, {job.attack}"


def _free_port(host: str, wanted: int) -> int:
    """The port wanted, or 0 (any free one) if somebody has it."""
    import socket

    try:
        socket.create_server((host, wanted)).close()
    except OSError:
        return 0
    return wanted
