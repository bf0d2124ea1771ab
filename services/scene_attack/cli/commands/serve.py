"""The commands that run and look after a service: `serve`, `api` and `worker` run it whole or in parts, `doctor` checks
the machine, `backup` copies the data. Options are settings; see docs/operations.md.
"""

import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scene_attack.cli.commands.options import DataOption, JsonOption
from scene_attack.cli.console import out, print_found, print_json, say

if TYPE_CHECKING:
    from scene_attack_service.settings import Settings


HostOption = Annotated[
    str | None,
    typer.Option(
        "--host",
        help="Address to listen on; one that other machines reach needs a key first (`keys create`) "
        "[SCENE_ATTACK_HOST, 127.0.0.1].",
    ),
]
PortOption = Annotated[
    int | None, typer.Option("--port", "-p", help="Port to listen on, 0 for a free one [SCENE_ATTACK_PORT, 8008].")
]
WorkersOption = Annotated[int | None, typer.Option("--workers", "-w", help="Job processes [SCENE_ATTACK_WORKERS, 1].")]
COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


app = typer.Typer()


@app.command(epilog="Example: [bold]scene-attack serve --port 8008 --workers 2[/bold]")
def serve(
    host: HostOption = None, port: PortOption = None, workers: WorkersOption = None, data: DataOption = None
) -> None:
    """Run the whole service: the API with the dashboard, workers, and a Redis unless SCENE_ATTACK_REDIS_URL names one.

    Prints "ready URL" once it takes jobs. Ctrl-C stops everything; a running job goes on from its checkpoint next time.
    """
    values = _settings(host=host, port=port, workers=workers, data=data)
    from scene_attack_worker.stack import serve as run

    raise typer.Exit(run(values))


@app.command(epilog="Example: [bold]SCENE_ATTACK_REDIS_URL=redis://redis:6379 scene-attack api --host 0.0.0.0[/bold]")
def api(host: HostOption = None, port: PortOption = None, data: DataOption = None) -> None:
    """Run only the API with the dashboard. Needs SCENE_ATTACK_REDIS_URL, as its workers run elsewhere."""
    values = _settings(host=host, port=port, data=data)
    from scene_attack_api.main import run

    raise typer.Exit(run(values))


@app.command(epilog="Example: [bold]SCENE_ATTACK_REDIS_URL=redis://redis:6379 scene-attack worker[/bold]")
def worker(workers: WorkersOption = None, data: DataOption = None) -> None:
    """Run only workers. Needs SCENE_ATTACK_REDIS_URL, and the database and data directory of the API."""
    values = _settings(workers=workers, data=data)
    from scene_attack_worker.main import run

    raise typer.Exit(run(values))


def _settings(**options: str | int | Path | None) -> "Settings":
    """The settings of a service, whose device and kernels are there. Names the variables that are no settings."""
    from scene_attack.cli.settings import read_settings, unknown_variables
    from scene_attack.process import check_device, use
    from scene_attack.rendering.kernels.build import check_kernels

    settings = read_settings(**options)
    for name, error in unknown_variables(os.environ).items():
        print(f"scene-attack: {name} is left out: {error}", file=sys.stderr)
    use(settings)
    check_device()
    check_kernels()
    return settings


@app.command(epilog="Example: [bold]scene-attack doctor[/bold]")
def doctor(as_json: JsonOption = False) -> None:
    """Check libraries, folders, disk, database, Redis, meshes, OpenGL, kernels and weights, and say what to do.

    Checks this machine with the settings of this environment. The exit code is 1 if something is missing without which
    the service cannot run, and 0 if all is well or the service only lacks something.
    """
    from scene_attack.cli.checkup import checkup
    from scene_attack.cli.settings import read_settings

    findings = []
    for finding in checkup(read_settings()):
        findings.append(finding)
        if not as_json:
            out().print(f"[{COLOURS[finding.level]}]{finding.level:<4}[/]", end="  ")
            say(f"{finding.subject}: {finding.text}", *([f"      → {finding.remedy}"] if finding.remedy else []))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    if any(finding.level == "fail" for finding in findings):
        raise typer.Exit(1)


@app.command(
    epilog="Examples: [bold]scene-attack backup /backups/monday[/bold]\n\n"
    "[bold]scene-attack backup /backups/monday --data /srv/scene-attack[/bold]\n\n"
    "To restore, start the service on a copy of the folder: [bold]scene-attack serve --data /srv/restored[/bold]. "
    "Of PostgreSQL, restore database.dump first: "
    "[bold]pg_restore --no-owner --dbname=URL /backups/monday/database.dump[/bold]"
)
def backup(
    folder: Annotated[Path, typer.Argument(help="A folder that does not exist yet, or is empty.")],
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Copy database, artifacts and uploaded meshes into FOLDER, while the service runs or not.

    The database is that of SCENE_ATTACK_DATABASE_URL, or SQLite in the data directory; PostgreSQL needs pg_dump, of the
    server's version or newer. Artifacts and meshes are those of SCENE_ATTACK_ARTIFACT_URL, or of the data directory.
    The copy is a data directory itself. Jobs that were running are taken up again where it is restored.
    """
    from scene_attack.cli.settings import read_settings
    from scene_attack_service.jobs.backup import back_up

    copied = back_up(read_settings(data=data), folder)
    summary = {"folder": str(folder), "files": copied.files, "bytes": copied.size, "jobs": copied.jobs}
    print_found(summary, f"{folder}  {copied.jobs:,} jobs, {copied.files:,} files, {copied.size:,} bytes", as_json)
