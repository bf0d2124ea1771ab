"""Options and preparations that the commands `train` share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

    from services.scenes.library import Library

OUT = Path("out/training")
Out = Annotated[Path, typer.Option(help="Folder of the checkpoints, the weights and the cards.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the weights, the views and the batches.")]


def progress_bars() -> "Progress":
    """Returns progress bars on the standard error."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from client.console import err

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=err())


def set_threads() -> None:
    """Has torch use the configured number of threads."""
    import torch

    from services.settings import settings

    torch.set_num_threads(settings().threads)


def library() -> "Library":
    """Returns the library of the configured folders."""
    from services.scenes.library import Library
    from services.settings import settings

    return Library(settings().cache_dir, settings().data_dir)
