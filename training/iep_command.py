"""The command `iep`: trains the network that answers questions about CLEVR-style scenes, or checks it."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from training.command_options import OUT, Out, Seed, progress_bars, settings_to_train

Said = Callable[[str, float, float, str], None]
LINE_SECONDS = 30.0
"""Time between lines where the standard error is no terminal."""


def iep(
    seconds_budget: Annotated[
        float | None, typer.Option(min=1, help="End after about so long, with everything saved, to go on later.")
    ] = None,
    scale: Annotated[
        float, typer.Option(min=1e-4, max=1, help="Share of the recipe's scenes and steps, for a trial.")
    ] = 1.0,
    out: Out = OUT,
    seed: Seed = 0,
    processes: Annotated[
        int | None, typer.Option(min=1, help="Processes that draw scenes, of 0.7 GB each; default: one for each core.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Train nothing: measure a checkpoint on the test scenes again.")
    ] = False,
    weights: Annotated[
        Path | None, typer.Option(help="The checkpoint to check; default: the one that ships with the project.")
    ] = None,
) -> None:
    """Train IEP: draw scenes, train its parts, measure it. A training that ended early goes on where it was."""
    from client.console import out as stdout
    from client.specs import local_library
    from services.errors import InvalidRequest
    from training.iep.export import SHIPPED, write
    from training.iep.export import check as checked
    from training.iep.processes import cores
    from training.iep.recipe import RECIPE
    from training.iep.stages import Stages

    if weights is not None and not check:
        raise InvalidRequest("--weights", "it is for --check")
    library = local_library(settings_to_train())
    end = None if seconds_budget is None else time.monotonic() + seconds_budget

    def over() -> bool:
        return end is not None and time.monotonic() > end

    drawing = processes or cores()
    with _telling() as said:
        if check:
            found = checked(weights or SHIPPED, out / "iep", library, said, over, drawing)
            lines = None if found is None else [found.summary, *found.disagreements]
        else:
            stages = Stages(RECIPE.scaled(scale), seed, out / "iep", library, said, over, drawing)
            command = f"python -m training iep --seed {seed}" + ("" if scale == 1 else f" --scale {scale:g}")
            lines = [write(stages, out, command, said).summary] if stages.run() else None
    if lines is None:
        stdout().print("not finished; the same command goes on", markup=False, highlight=False)
        return
    stdout().print("\n".join(lines), markup=False, highlight=False, soft_wrap=True)
    if check and len(lines) > 1:
        raise typer.Exit(1)


@contextmanager
def _telling() -> Iterator[Said]:
    """Shows progress bars, and lines now and then where there is no terminal."""
    from rich.progress import TaskID

    from client.console import err

    steps: dict[str, TaskID] = {}
    before = 0.0
    with progress_bars() as progress:

        def said(what: str, done: float, total: float, words: str) -> None:
            nonlocal before
            if what not in steps:
                steps[what] = progress.add_task(what, total=total)
            progress.update(steps[what], completed=done, total=total, description=f"{what}  {words}".strip())
            if not err().is_terminal and (done >= total or time.monotonic() - before > LINE_SECONDS):
                before = time.monotonic()
                err().print(f"{what} {done:,.0f} of {total:,.0f}  {words}".strip(), markup=False, highlight=False)

        yield said
