"""The command `backup`."""

from pathlib import Path
from typing import Annotated

import typer

from scene_attack.cli.commands.options import DataOption, JsonOption
from scene_attack.cli.console import print_found

app = typer.Typer()


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
    from scene_attack_service.jobs.backup import back_up
    from scene_attack_service.settings import read_settings

    copied = back_up(read_settings(data=data), folder)
    summary = {"folder": str(folder), "files": copied.files, "bytes": copied.size, "jobs": copied.jobs}
    print_found(summary, f"{folder}  {copied.jobs:,} jobs, {copied.files:,} files, {copied.size:,} bytes", as_json)
