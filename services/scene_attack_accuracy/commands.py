"""The commands `accuracy`: they write the reports of docs/accuracy on renderers and attacks."""

from pathlib import Path
from typing import Annotated

import typer

from scene_attack.cli.commands.options import JsonOption
from scene_attack.cli.console import FittedTable, err, print_found, print_json, remark
from scene_attack.process import replaced

app = typer.Typer(help="Reports on how exact and how stable the methods are.", no_args_is_help=True)

OUT = Path("docs/accuracy")


@app.command(
    epilog="Examples: [bold]scene-attack accuracy stability[/bold]\n\n"
    "[bold]scene-attack accuracy stability --quick --out out/accuracy[/bold]"
)
def stability(
    quick: Annotated[
        bool, typer.Option("--quick", help="Leave out the few cases that take longer than seconds.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Directory for stability.md and stability.json.")] = OUT,
    as_json: JsonOption = False,
) -> None:
    """Run every stiff and extreme case on the CPU, and write the report.

    The exit code is 1 if any case failed; its reason is printed.
    """
    import torch

    from scene_attack.runs.environment import options_to_run
    from scene_attack_accuracy.provenance import Provenance
    from scene_attack_accuracy.stability.case import observe
    from scene_attack_accuracy.stability.report import WORDS, Report, cases, write

    torch.set_num_threads(options_to_run().threads)
    chosen, observations = cases(quick), []
    with replaced(device="cpu"), err().status("") as line:
        for number, case in enumerate(chosen, 1):
            line.update(f"{number}/{len(chosen)}  {case.family}: {case.name}")
            observations.append(observe(case))
    command = "scene-attack accuracy stability" + (" --quick" if quick else "")
    result = Report(measured=Provenance.now(command), cases=observations)
    write(result, out)
    rows = [[family, *(str(result.count(word, family)) for word in WORDS)] for family in result.families]
    rows.append(["all", *(str(result.count(word)) for word in WORDS)])
    print_found(result, FittedTable(("family", *(f"{word}>" for word in WORDS)), rows), as_json)
    failed = [f"failed: {row.family}: {row.name}: {row.what}" for row in result.cases if row.outcome == "failed"]
    remark(*failed, f"Report in {out}")
    if failed:
        raise typer.Exit(1)


@app.command(
    epilog="Examples: [bold]scene-attack accuracy work-precision[/bold]\n\n"
    "[bold]scene-attack accuracy work-precision --quick --out out/accuracy[/bold]"
)
def work_precision(
    quick: Annotated[bool, typer.Option("--quick", help="Smaller images and fewer maps.")] = False,
    out: Annotated[Path, typer.Option(help="Directory for work-precision.md and .json.")] = OUT,
    as_json: JsonOption = False,
) -> None:
    """Measure error against run time on the CPU: plans of each tolerance, options of scenes; write the report.

    Its seconds mean something only on a machine that does nothing else.
    """
    import torch

    from scene_attack.runs.environment import options_to_run
    from scene_attack_accuracy.work_precision import FULL, QUICK, measure, write

    torch.set_num_threads(options_to_run().threads)
    command = "scene-attack accuracy work-precision" + (" --quick" if quick else "")
    with replaced(device="cpu"), err().status("") as line:
        result = measure(QUICK if quick else FULL, command, line.update)
    write(result, out)
    if as_json:
        print_json(result)
    remark(f"Report in {out}")


def add(root: typer.Typer) -> None:
    """Adds these commands to those of `scene-attack`."""
    root.add_typer(app, name="accuracy")
