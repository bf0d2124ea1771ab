"""`backup`: a consistent copy of a service's data while it runs."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import DataOption, JsonOption


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(
        epilog="Examples: [bold]scene-attack backup /backups/monday[/bold]\n\n"
        "[bold]scene-attack backup /backups/monday --data /srv/scene-attack[/bold]\n\n"
        "To restore, start the service on a copy of the folder: [bold]scene-attack serve --data /srv/restored[/bold]. "
        "Of PostgreSQL, restore database.dump first: "
        "[bold]pg_restore --no-owner --dbname=URL /backups/monday/database.dump[/bold]"
    )(backup)


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
    from client.console import out, print_json
    from client.settings import read_settings
    from services.jobs.backup import back_up

    made = back_up(read_settings(data=data), folder)
    if as_json:
        print_json({"folder": str(folder), "files": made.files, "bytes": made.size, "jobs": made.jobs})
    else:
        said = f"{folder}  {made.jobs:,} jobs, {made.files:,} files, {made.size:,} bytes"
        out().print(said, markup=False, highlight=False)
