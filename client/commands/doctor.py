"""The command `doctor`: whether everything is there that the service needs, and what to do where it is not."""

from dataclasses import asdict

import typer

from client.commands.options import JsonOption

COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(epilog="Example: [bold]scene-attack doctor[/bold]")(doctor)


def doctor(as_json: JsonOption = False) -> None:
    """Check libraries, folders, disk, database, Redis, meshes, OpenGL, kernels and weights, and say what to do.

    Checks this machine with the settings of this environment. The exit code is 1 if something is missing without which
    the service cannot run, and 0 if all is well or the service only lacks something.
    """
    from client.checkup import checkup
    from client.console import out, print_json
    from client.settings import read_settings

    found = []
    console = out()
    for one in checkup(read_settings()):
        found.append(one)
        if not as_json:
            console.print(f"[{COLOURS[one.level]}]{one.level:<4}[/]", end="  ")
            console.print(f"{one.subject}: {one.text}", markup=False, highlight=False, soft_wrap=True)
            if one.remedy:
                console.print(f"      → {one.remedy}", markup=False, highlight=False, soft_wrap=True)
    if as_json:
        print_json([asdict(one) for one in found])
    if any(one.level == "fail" for one in found):
        raise typer.Exit(1)
