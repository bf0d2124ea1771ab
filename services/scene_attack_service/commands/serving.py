"""The options of commands that run a service or a part of it. They are settings; see docs/operations.md."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from scene_attack_service.settings import Settings

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


def serving_settings(**options: str | int | Path | None) -> "Settings":
    """The settings of a service, whose device and kernels are there. Names the variables that are no settings."""
    from scene_attack.process import check_device, use
    from scene_attack.rendering.kernels import levels
    from scene_attack_service.settings import read_settings, unknown_variables

    settings = read_settings(**options)
    for name, error in unknown_variables(os.environ).items():
        print(f"scene-attack: {name} is left out: {error}", file=sys.stderr)
    use(settings)
    check_device()
    levels.level()  # refuses kernels that are asked for and not there: each job would fail
    return settings
