"""`serve`, `api` and `worker`: the service, whole or in parts. Options are settings; see docs/operations.md."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from client.commands.options import DataOption

if TYPE_CHECKING:
    from services.settings import Settings

HostOption = Annotated[
    str | None,
    typer.Option(
        "--host",
        help="Address to listen on; one that other machines reach needs a key first (`keys create`) "
        "[SCENE_ATTACK_HOST, 127.0.0.1].",
    ),
]
PortOption = Annotated[
    int | None, typer.Option("--port", "-p", help="Port to listen on, 0 for a free one [SCENE_ATTACK_PORT, 8008].")
]
WorkersOption = Annotated[int | None, typer.Option("--workers", "-w", help="Job processes [SCENE_ATTACK_WORKERS, 1].")]


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(epilog="Example: [bold]scene-attack serve --port 8008 --workers 2[/bold]")(serve)
    app.command(
        epilog="Example: [bold]SCENE_ATTACK_REDIS_URL=redis://redis:6379 scene-attack api --host 0.0.0.0[/bold]"
    )(api)
    app.command(epilog="Example: [bold]SCENE_ATTACK_REDIS_URL=redis://redis:6379 scene-attack worker[/bold]")(worker)


def serve(
    host: HostOption = None, port: PortOption = None, workers: WorkersOption = None, data: DataOption = None
) -> None:
    """Run the whole service: the API with the dashboard, workers, and a Redis unless SCENE_ATTACK_REDIS_URL names one.

    Prints "ready URL" once it takes jobs. Ctrl-C stops everything; a running job goes on from its checkpoint next time.
    """
    values = _settings(host=host, port=port, workers=workers, data=data)
    from worker.stack import serve as run

    raise typer.Exit(run(values))


def api(host: HostOption = None, port: PortOption = None, data: DataOption = None) -> None:
    """Run only the API with the dashboard. Needs SCENE_ATTACK_REDIS_URL, as its workers run elsewhere."""
    values = _settings(host=host, port=port, data=data)
    from api.main import run

    raise typer.Exit(run(values))


def worker(workers: WorkersOption = None, data: DataOption = None) -> None:
    """Run only workers. Needs SCENE_ATTACK_REDIS_URL, and the database and data directory of the API."""
    values = _settings(workers=workers, data=data)
    from worker.main import run

    raise typer.Exit(run(values))


def _settings(**options: str | int | Path | None) -> "Settings":
    """The settings of a service, whose device and kernels are there. Names the variables that are no settings."""
    from client.settings import read_settings
    from client.unknown_variables import unknown_variables
    from services.device import check_device
    from services.process import use
    from services.rendering.kernels.build import check_kernels

    settings = read_settings(**options)
    for name, error in unknown_variables(os.environ).items():
        print(f"scene-attack: {name} is left out: {error}", file=sys.stderr)
    use(settings)
    check_device()
    check_kernels()
    return settings
