"""Options and preparations that the commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

    from services.settings import Settings

OUT = Path("out/training")
Out = Annotated[Path, typer.Option(help="Folder of the checkpoints, the weights and the cards.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the weights, the views and the batches.")]


def progress_bars() -> "Progress":
    """Returns progress bars on the standard error."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from client.console import err

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=err())


def settings_to_train() -> "Settings":
    """The settings of the environment, by which this process and torch's threads are set up."""
    import torch

    from client.settings import settings_to_run

    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    return settings
