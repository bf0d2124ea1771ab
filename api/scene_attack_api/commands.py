"""The command `api`, which runs a service without workers."""

import typer

from scene_attack.cli.commands.options import DataOption
from scene_attack_service.commands.serving import HostOption, PortOption, serving_settings

app = typer.Typer()


@app.command(epilog="Example: [bold]SCENE_ATTACK_REDIS_URL=redis://redis:6379 scene-attack api --host 0.0.0.0[/bold]")
def api(host: HostOption = None, port: PortOption = None, data: DataOption = None) -> None:
    """Run only the API with the dashboard. Needs SCENE_ATTACK_REDIS_URL, as its workers run elsewhere."""
    values = serving_settings(host=host, port=port, data=data)
    from scene_attack_api.main import run

    raise typer.Exit(run(values))


def add(root: typer.Typer) -> None:
    """Adds this command to those of `scene-attack`."""
    root.add_typer(app)
