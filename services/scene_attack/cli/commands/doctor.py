"""The command `doctor`."""

from dataclasses import asdict

import typer

from scene_attack.cli.commands.options import JsonOption
from scene_attack.cli.console import out, print_json, say

COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}

app = typer.Typer()


@app.command(epilog="Example: [bold]scene-attack doctor[/bold]")
def doctor(as_json: JsonOption = False) -> None:
    """Check libraries, folders, disk, database, Redis, meshes, OpenGL, kernels and weights, and say what to do.

    Checks this machine with the settings of this environment. The exit code is 1 if something is missing without which
    no job or no service can run, and 0 if all is well or something is only lacking.
    """
    from scene_attack.cli.checkup import checkup
    from scene_attack.runs.environment import read_options

    findings = []
    for finding in checkup(read_options()):
        findings.append(finding)
        if not as_json:
            out().print(f"[{COLOURS[finding.level]}]{finding.level:<4}[/]", end="  ")
            say(f"{finding.subject}: {finding.text}", *([f"      → {finding.remedy}"] if finding.remedy else []))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    if any(finding.level == "fail" for finding in findings):
        raise typer.Exit(1)
