"""Options of several commands."""

from pathlib import Path
from typing import Annotated, Literal

import typer

DEFAULT_URL = "http://127.0.0.1:8008"

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
DataOption = Annotated[
    Path | None, typer.Option("--data", help="Directory of database, artifacts and uploads [SCENE_ATTACK_DATA].")
]
SeedOption = Annotated[int | None, typer.Option("--seed", min=0, help="Use this seed instead of the spec's.")]
PriorityOption = Annotated[
    Literal["high", "normal", "low"] | None,
    typer.Option("--priority", help="Jobs of a higher priority are taken first; default: normal, of campaigns low."),
]
UrlOption = Annotated[str, typer.Option("--url", envvar="SCENE_ATTACK_URL", help="URL of the service.")]
