"""`accuracy`: how exact the renderers and the attacks are, and where they end; the reports of docs/accuracy."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import JsonOption

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
    """Run every stiff and extreme case, and write the report.

    The exit code is 1 if any case failed; its reason is printed.
    """
    import torch

    from client.console import err, print_json, table
    from client.console import out as stdout
    from services.accuracy.case import Case
    from services.accuracy.report import report, write
    from services.accuracy.stability import cases, run
    from services.settings import settings

    torch.set_num_threads(settings().threads)
    chosen = cases(quick)
    with err().status("") as line:
        numbers = iter(range(1, len(chosen) + 1))

        def show(case: Case) -> None:
            line.update(f"{next(numbers)}/{len(chosen)}  {case.family}: {case.name}")

        observations = run(chosen, show)
    found = report(observations, "scene-attack accuracy stability" + (" --quick" if quick else ""))
    write(found, out)
    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        families = dict.fromkeys(row.family for row in found.cases)
        counted = [
            [
                family,
                *(str(sum(r.family == family and r.outcome == word for r in found.cases)) for word in found.counts),
            ]
            for family in families
        ]
        total = ["all", *map(str, found.counts.values())]
        stdout().print(table(("family", *(f"{word}>" for word in found.counts)), [*counted, total]))
    for row in found.failed:
        err().print(f"failed: {row.family}: {row.name}: {row.what}", markup=False, highlight=False, style="red")
    err().print(f"Report in {out}", markup=False, highlight=False)
    if found.failed:
        raise typer.Exit(1)
