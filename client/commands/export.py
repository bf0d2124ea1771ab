"""The command `export`: a finished job as glTF scenes, images, maps, tables and a README, for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import DEFAULT_URL, UrlOption


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(
        epilog="Examples: [bold]scene-attack export 0f3c… --out piano.zip[/bold]\n\n"
        "[bold]scene-attack export out/combined --out out/combined-export[/bold]"
    )(export)


def export(
    job: Annotated[
        str, typer.Argument(metavar="ID|FOLDER", help="A job of the service, or a folder that `run --out` wrote.")
    ],
    to: Annotated[
        Path | None,
        typer.Option(
            "--out", help="A file that ends in .zip, or a new folder. Default: a zip file named after the job."
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
) -> None:
    """Take a finished job along: scenes as glTF, light and normals, images, parameters with names and units."""
    from client.console import out
    from services.errors import InvalidRequest

    folder = Path(job)
    local = folder.is_dir()
    if not local and ("/" in job or folder.exists()):
        raise InvalidRequest("ID|FOLDER", f"{job} is neither the id of a job nor a folder that `run --out` wrote")
    name = f"{folder.resolve().name}-export" if local else f"scene-attack-{job[:8]}"
    to = to or Path(f"{name}.zip")
    as_zip = to.suffix == ".zip"
    if not as_zip and to.exists() and (not to.is_dir() or any(to.iterdir())):
        raise InvalidRequest(
            "--out", f"{to} is there already, and no empty folder; name another, or a file ending in .zip"
        )
    if local:
        _export_folder(folder, to, name if as_zip else None)
    else:
        _export_job(job, to, url)
    out().print(f"Written to {to}", markup=False, highlight=False)


def _export_folder(folder: Path, to: Path, name: str | None) -> None:
    """Exports a result folder into a zip file whose files are in a folder `name`, or into a folder if that is None."""
    from client.commands.run import library
    from client.live import JobLine
    from services import atomic_write

    with JobLine(str(folder)) as line:
        line.update("loading", 0, 1, None)
        assets = library()
        from services.export.bundle import write_bundle
        from services.export.destinations import into_folder, zipped

        files = {path.name: path.read_bytes for path in folder.iterdir() if path.is_file()}
        if name is None:
            write_bundle(files, assets, into_folder(to))
            return
        with atomic_write.replacing(to) as part, part.open("wb") as file, zipped(file, name) as write:
            write_bundle(files, assets, write)


def _export_job(job: str, to: Path, url: str) -> None:
    from tempfile import TemporaryDirectory
    from zipfile import ZipFile

    from client.api_client import ApiClient

    with ApiClient(url) as client, TemporaryDirectory() as folder:
        if to.suffix == ".zip":
            client.export(job, to)
            return
        archive = Path(folder) / "export.zip"
        client.export(job, archive)
        to.mkdir(parents=True, exist_ok=True)
        with ZipFile(archive) as found:
            for entry in found.infolist():
                # A service can name no file outside the folder.
                (to / Path(entry.filename).name).write_bytes(found.read(entry))
