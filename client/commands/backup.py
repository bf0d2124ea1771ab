"""`backup`: a consistent copy of a service's data while it runs."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import JsonOption


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(
        epilog="Examples: [bold]scene-attack backup /backups/monday[/bold]\n\n"
        "[bold]SCENE_ATTACK_DATA=/srv/scene-attack scene-attack backup /backups/monday[/bold]\n\n"
        "To restore, stop the service and start it on a copy of the folder: "
        "[bold]scene-attack serve --data /srv/restored[/bold]"
    )(backup)


def backup(
    folder: Annotated[Path, typer.Argument(help="A folder that does not exist yet, or is empty.")],
    as_json: JsonOption = False,
) -> None:
    """Copy database, artifacts and uploaded meshes of the data directory into FOLDER, while the service runs or not.

    The copy is a data directory itself. Jobs that were running in it are taken up again where it is restored. A
    PostgreSQL database is not copied: run pg_dump first, then this.
    """
    from client.console import err, out, print_json
    from services.jobs.backup import back_up
    from services.settings import settings

    values = settings()
    other = values.database_url is not None
    made = back_up(values.data_dir, folder, with_database=not other, with_files=values.artifact_url is None)
    if as_json:
        print_json({"folder": str(folder), "files": made.files, "bytes": made.size, "jobs": made.jobs})
    else:
        jobs = "" if made.jobs is None else f"{made.jobs:,} jobs, "
        out().print(f"{folder}  {jobs}{made.files:,} files, {made.size:,} bytes", markup=False, highlight=False)
    if values.artifact_url is not None:
        err().print("Artifacts and meshes are not in it: they are in SCENE_ATTACK_ARTIFACT_URL.", highlight=False)
    if other:
        err().print(
            "The database is not in it. Copy it first, so that the files hold all that it names: "
            f"pg_dump --format=custom --file={folder}.dump DATABASE_URL",
            markup=False,
            highlight=False,
        )
