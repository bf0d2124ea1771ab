"""`python -m training` divides the library's models and trains the networks that ship with the project."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from training.command_options import OUT, Out, Seed, progress_bars, settings_to_train
from training.iep_command import iep

app = typer.Typer(
    help="Train the networks that ship with the project.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)

Minutes = Annotated[float | None, typer.Option(min=0.1, help="Train so long; the schedule follows the clock.")]
Epochs = Annotated[
    int | None, typer.Option(min=1, help="Train so many times over all views, reproducible bit for bit.")
]
Export = Annotated[
    bool, typer.Option("--export", help="Train no more: write weights and cards from the checkpoint as it is.")
]


@app.command(epilog="Example: [bold]python -m training split[/bold]")
def split(
    out: Annotated[Path | None, typer.Option(help="File to write; default: the committed one.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the order in which families are held out.")] = 0,
) -> None:
    """Divide the library's models by family, and choose the classes inside the training models."""
    from client.console import err
    from client.specs import local_library
    from training.making_split import make
    from training.split import PATH, save

    settings = settings_to_train()
    command = f"python -m training split --seed {seed}"
    with err().status("") as line:
        made = make(local_library(settings), settings.cache_dir, seed, command, lambda words: line.update(words))
    save(made, out or PATH)
    held_out, training = (len(made.models(side)) for side in ("held_out", "training"))
    err().print(
        f"{len(made.classes)} classes, {training} models for training, {held_out} held out; cross-validated accuracy "
        f"of a linear probe {made.accuracy:.3f}: {', '.join(made.classes)}",
        markup=False,
        highlight=False,
    )


@app.command(epilog="Example: [bold]python -m training alexnet --minutes 45[/bold]")
def alexnet(
    minutes: Minutes = None, epochs: Epochs = None, out: Out = OUT, seed: Seed = 0, export: Export = False
) -> None:
    """Train AlexNet. A killed training goes on from its checkpoint."""
    _train("alexnet", minutes, epochs, out, seed, export)


@app.command(epilog="Example: [bold]python -m training resnet34 --epochs 40[/bold]")
def resnet34(
    minutes: Minutes = None, epochs: Epochs = None, out: Out = OUT, seed: Seed = 0, export: Export = False
) -> None:
    """Train ResNet-34. A killed training goes on from its checkpoint."""
    _train("resnet34", minutes, epochs, out, seed, export)


app.command(epilog="Example: [bold]python -m training iep --seconds-budget 3600[/bold]")(iep)


def _train(name: str, minutes: float | None, epochs: int | None, out: Path, seed: int, export: bool) -> None:
    from rich.progress import TaskID

    from client.console import err
    from client.console import out as stdout
    from client.specs import local_library
    from services.errors import InvalidRequest
    from training.data import gather
    from training.export import write
    from training.recipe import RECIPES, Budget
    from training.split import committed
    from training.training import Report, Training, load_trained

    if not export and (minutes is None) == (epochs is None):
        raise InvalidRequest("--minutes", "give either --minutes or --epochs")
    settings = settings_to_train()
    library, recipe, chosen = local_library(settings), RECIPES[name], committed()
    cache = settings.cache_dir
    checkpoint = out / f"{name}.checkpoint"
    with progress_bars() as progress:
        steps: dict[str, TaskID] = {}

        def said(what: str, done: int, total: int) -> None:
            if what not in steps:
                steps[what] = progress.add_task(what, total=total)
            progress.update(steps[what], completed=done, total=total)

        if not export:
            data = gather(library, cache, recipe, chosen.models("training"), seed, said)
            training = Training(recipe, len(chosen.classes), data, seed, checkpoint)
            if training.step:
                err().print(f"goes on from step {training.step:,} of {checkpoint}", markup=False, highlight=False)
            task = progress.add_task("training", total=1.0)

            def report(at: Report) -> None:
                means = f"loss {at.loss:.3f}  right {at.accuracy:.3f}"
                words = f"epoch {at.epoch:.1f}  {means}  {at.rate:.0f} images/s"
                progress.update(task, completed=at.progress, description=words)
                if not err().is_terminal:
                    err().print(f"{at.progress:6.3f}  step {at.step:,}  {words}", markup=False, highlight=False)

            training.run(Budget(minutes, epochs), report)
            del data, training
        trained = load_trained(recipe, len(chosen.classes), checkpoint)
        written = write(recipe, trained, chosen, library, cache, out, said)
    stdout().print(written.summary, markup=False, highlight=False)


def main() -> None:
    """Runs a command. Bad input and failures become lines on the standard error, and exit codes 2 and 1."""
    from services.errors import InvalidRequest, JobFailure

    try:
        app(prog_name="python -m training")
    except InvalidRequest as error:
        print(*(f"bad input: {one.field}: {one.detail}" for one in error.every), sep="\n", file=sys.stderr)
        sys.exit(2)
    except JobFailure as error:
        print(f"failed ({error.kind}): {error.detail}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
