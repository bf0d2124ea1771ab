"""The commands `serve` and `worker`: they run a service whole, or its workers. Options are settings; see
docs/operations.md.
"""

import typer

from scene_attack.cli.commands.options import DataOption
from scene_attack_service.commands.serving import HostOption, PortOption, WorkersOption, serving_settings

app = typer.Typer()


@app.command(epilog="Example: [bold]scene-attack serve --port 8008 --workers 2[/bold]")
def serve(
    host: HostOption = None, port: PortOption = None, workers: WorkersOption = None, data: DataOption = None
) -> None:
    """Run the whole service: the API with the dashboard, workers, and a Redis unless SCENE_ATTACK_REDIS_URL names one.

    Prints "ready URL" once it takes jobs. Ctrl-C stops everything; a running job goes on from its checkpoint next time.
    """
    values = serving_settings(host=host, port=port, workers=workers, data=data)
    from scene_attack_worker.stack import serve as run

    raise typer.Exit(run(values))


@app.command(epilog="Example: [bold]SCENE_ATTACK_REDIS_URL=redis://redis:6379 scene-attack worker[/bold]")
def worker(workers: WorkersOption = None, data: DataOption = None) -> None:
    """Run only workers. Needs SCENE_ATTACK_REDIS_URL, and the database and data directory of the API."""
    values = serving_settings(workers=workers, data=data)
    from scene_attack_worker.main import run

    raise typer.Exit(run(values))
