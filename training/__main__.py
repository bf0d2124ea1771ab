"""`python -m training` divides the library's models and trains the networks that ship with the project."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from scene_attack.options import Options
    from training.loop import Said

OUT = Path("out/training")
Out = Annotated[Path, typer.Option(help="Folder of the checkpoints, the weights and the cards.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the weights, the views and the batches.")]
Minutes = Annotated[float | None, typer.Option(min=0.1, help="Train so long; the schedule follows the clock.")]
Epochs = Annotated[
    int | None, typer.Option(min=1, help="Train so many times over all views, reproducible bit for bit.")
]
Export = Annotated[
    bool, typer.Option("--export", help="Train no more: write weights and cards from the checkpoint as it is.")
]
OneLook = Annotated[
    bool,
    typer.Option(
        "--one-look",
        help="Know one light and one material, as the paper's networks do; for SCENE_ATTACK_TARGETS, not shipped.",
    ),
]
LINE_SECONDS = 30.0
"""Time between lines where the standard error is no terminal."""

app = typer.Typer(
    help="Train the networks that ship with the project.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


@app.command(epilog="Example: [bold]python -m training split[/bold]")
def split(
    out: Annotated[Path | None, typer.Option(help="File to write; default: the committed one.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the order in which families are held out.")] = 0,
) -> None:
    """Divide the library's models by family, and choose the classes inside the training models."""
    from scene_attack.cli.console import err
    from scene_attack.cli.specs import local_library
    from training.split import PATH, make, save

    options = options_to_train()
    command = f"python -m training split --seed {seed}"
    with err().status("") as line:
        result = make(local_library(options), options.cache_dir, seed, command, lambda words: line.update(words))
    save(result, out or PATH)
    held_out, training = (len(result.models(side)) for side in ("held_out", "training"))
    err().print(
        f"{len(result.classes)} classes, {training} models for training, {held_out} held out; cross-validated accuracy "
        f"of a linear probe {result.accuracy:.3f}: {', '.join(result.classes)}",
        markup=False,
        highlight=False,
    )


@app.command(epilog="Example: [bold]python -m training alexnet --minutes 45[/bold]")
def alexnet(
    minutes: Minutes = None,
    epochs: Epochs = None,
    out: Out = OUT,
    seed: Seed = 0,
    export: Export = False,
    one_look: OneLook = False,
) -> None:
    """Train AlexNet. A killed training goes on from its checkpoint."""
    _train("alexnet", minutes, epochs, out, seed, export, one_look)


@app.command(epilog="Example: [bold]python -m training resnet34 --epochs 40[/bold]")
def resnet34(
    minutes: Minutes = None,
    epochs: Epochs = None,
    out: Out = OUT,
    seed: Seed = 0,
    export: Export = False,
    one_look: OneLook = False,
) -> None:
    """Train ResNet-34. A killed training goes on from its checkpoint."""
    _train("resnet34", minutes, epochs, out, seed, export, one_look)


@app.command(epilog="Example: [bold]python -m training iep --seconds-budget 3600[/bold]")
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
    from scene_attack.cli.console import out as stdout
    from scene_attack.cli.specs import local_library
    from scene_attack.errors import InvalidRequest
    from training.iep.export import SHIPPED, write
    from training.iep.export import check as checked
    from training.iep.processes import cores
    from training.iep.recipe import RECIPE
    from training.iep.stages import Stages

    if weights is not None and not check:
        raise InvalidRequest("--weights", "it is for --check")
    library = local_library(options_to_train())
    end = None if seconds_budget is None else time.monotonic() + seconds_budget

    def over() -> bool:
        return end is not None and time.monotonic() > end

    drawing = processes or cores()
    with _telling() as said:
        if check:
            outcome = checked(weights or SHIPPED, out / "iep", library, said, over, drawing)
            lines = None if outcome is None else [outcome.summary, *outcome.disagreements]
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


def _train(
    name: str, minutes: float | None, epochs: int | None, out: Path, seed: int, export: bool, is_one_look: bool
) -> None:
    from scene_attack.cli.console import err
    from scene_attack.cli.console import out as stdout
    from scene_attack.cli.specs import local_library
    from scene_attack.errors import InvalidRequest
    from training.export import write, write_target
    from training.loop import Report
    from training.split import committed
    from training.training import RECIPES, Budget, Training, gather, load_trained, one_look

    if not export and (minutes is None) == (epochs is None):
        raise InvalidRequest("--minutes", "give either --minutes or --epochs")
    options = options_to_train()
    library, chosen = local_library(options), committed()
    recipe = one_look(RECIPES[name]) if is_one_look else RECIPES[name]
    checkpoint = out / f"{recipe.name}.checkpoint"
    with _telling() as said:
        if not export:
            data = gather(library, options.cache_dir, recipe, chosen.models("training"), seed, said)
            training = Training(recipe, len(chosen.classes), data, seed, checkpoint)
            if training.loop.step:
                err().print(f"goes on from step {training.loop.step:,} of {checkpoint}", markup=False, highlight=False)

            def report(at: Report) -> None:
                means = "  ".join(f"{part} {mean:.3f}" for part, mean in at.losses.items())
                epoch = at.step / training.steps_per_epoch
                said("training", at.progress, 1.0, f"epoch {epoch:.1f}  {means}  {at.rate * recipe.batch:.0f} images/s")

            training.run(Budget(minutes, epochs), report)
            del data, training
        trained = load_trained(recipe, len(chosen.classes), checkpoint)
        if is_one_look:
            folder = write_target(recipe, trained, chosen, out)
            command = f"SCENE_ATTACK_TARGETS={out} scene-attack targets check {folder.name}"
            stdout().print(command, markup=False, highlight=False)
            return
        written = write(recipe, trained, chosen, library, options.cache_dir, out, said)
    stdout().print(written.summary, markup=False, highlight=False)


@contextmanager
def _telling() -> "Iterator[Said]":
    """Shows progress bars, and lines now and then where there is no terminal."""
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from scene_attack.cli.console import err

    steps: dict[str, TaskID] = {}
    before = 0.0
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err()) as progress:

        def said(what: str, done: float, total: float, words: str) -> None:
            nonlocal before
            if what not in steps:
                steps[what] = progress.add_task(what, total=total)
            progress.update(steps[what], completed=done, total=total, description=f"{what}  {words}".strip())
            if not err().is_terminal and (done >= total or time.monotonic() - before > LINE_SECONDS):
                before = time.monotonic()
                err().print(f"{what} {done:,.4g} of {total:,.0f}  {words}".strip(), markup=False, highlight=False)

        yield said


def options_to_train() -> "Options":
    """The options of the environment, by which this process and torch's threads are set up."""
    import torch

    from scene_attack.runs.environment import options_to_run

    options = options_to_run()
    torch.set_num_threads(options.threads)
    return options


def main() -> None:
    """Runs a command. Bad input and failures become lines on the standard error, and exit codes 2 and 1."""
    from scene_attack.errors import InvalidRequest, JobFailure

    try:
        app(prog_name="python -m training")
    except InvalidRequest as error:
        print(*(f"bad input: {wrong.field}: {wrong.detail}" for wrong in error.every), sep="\n", file=sys.stderr)
        sys.exit(2)
    except JobFailure as error:
        print(f"failed ({error.kind}): {error.detail}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
