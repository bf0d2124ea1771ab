"""The commands `targets`: the networks that can be attacked, and a trial of one."""

from typing import TYPE_CHECKING, Annotated

import typer

from scene_attack.cli.commands.options import JsonOption
from scene_attack.cli.console import (
    FittedTable,
    err,
    print_found,
    print_json,
    report_plugins,
    report_targets,
    say,
    yes,
)

if TYPE_CHECKING:
    from rich.text import Text

    from scene_attack.runs.target_check import TargetCheck

app = typer.Typer(help="The networks that can be attacked.")

DEFAULT_MESH = "furniture/grand-piano"


@app.callback(
    invoke_without_command=True,
    epilog="Examples: [bold]scene-attack targets[/bold]\n\n[bold]scene-attack targets check efficientnet-lite0[/bold]",
)
def targets(context: typer.Context, as_json: JsonOption = False) -> None:
    """List the networks that can be attacked."""
    if context.invoked_subcommand is not None:
        return
    from scene_attack.runs.environment import read_options
    from scene_attack.runs.set_up import set_up
    from scene_attack.targets.info import available

    set_up(read_options())
    report_plugins()
    report_targets()
    networks = available()
    rows: list[list[str | Text]] = []
    for t in networks:
        gradient = "known once loaded" if t.differentiable is None else yes(t.differentiable)
        size = "×".join(map(str, t.input_size))
        rows.append([t.name, t.title, t.task, size, f"{t.classes:,}", gradient, t.licence])
    columns = ("target", "title", "task", "input", "classes>", "differentiable", "licence")
    print_found(networks, FittedTable(columns, rows, spare=("licence", "task", "title")), as_json)
    if not as_json:
        say(*(f"{t.name}: {t.missing}" for t in networks if t.missing is not None))


@app.command(epilog="Example: [bold]scene-attack targets check efficientnet-lite0[/bold]")
def check(
    name: Annotated[str, typer.Argument(help="A name from `targets`.")],
    mesh: Annotated[str, typer.Option(help="The mesh whose view it is shown.")] = DEFAULT_MESH,
    as_json: JsonOption = False,
) -> None:
    """Load a network, show it a view, and print its card, its answers, whether it has gradients, and its speed.

    A network that must be asked something is asked the example of its task.

    The exit code is 2 if it cannot be used; the message says why.
    """
    from scene_attack.cli.commands.run import library
    from scene_attack.runs.environment import options_to_run

    options = options_to_run()
    report_plugins()
    with err().status("loading") as line:
        assets = library(options)
        from scene_attack.runs.target_check import check as try_target

        checked = try_target(name, mesh, assets, line.update)
    if as_json:
        print_json(checked)
    else:
        _print(checked)


def _print(checked: "TargetCheck") -> None:
    card = checked.target
    facts = {
        "target": card.name,
        "title": card.title,
        "input": "×".join(map(str, card.input_size)),
        "classes": f"{card.classes:,}",
        "licence": card.licence,
        "source": card.source,
        "weights sha256": checked.weights_sha256,
        "card sha256": card.card_sha256 or "",
        "backend": checked.backend,
        "gradient": "yes" if checked.gradient else f"no: {checked.no_gradient}",
    } | {f"time, batch of {count}": f"{1000 * time:.2f} ms an image" for count, time in checked.seconds.items()}
    say(FittedTable(("", ""), facts.items()))
    rows = [[answer.label, f"{answer.probability:.3f}"] for answer in checked.answers]
    shown = "a generated scene" if checked.mesh is None else f"a view of {checked.mesh}"
    asked = f"{checked.asked!r} about " if checked.asked else ""
    say(FittedTable((f"answer to {asked}{shown}", "probability>"), rows))
