"""The command `export`: a finished job as glTF scenes, images, maps, tables and a README, for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from scene_attack.cli.commands.options import SHORT, JsonOption, UrlOption, whole_job_id
from scene_attack.cli.console import print_found
from scene_attack.client import DEFAULT_URL
from scene_attack.extras import extra

app = typer.Typer()


@app.command(
    epilog="Examples: [bold]scene-attack export 0f3c… --out piano.zip[/bold]\n\n"
    "[bold]scene-attack export out/combined --out out/combined-export[/bold]"
)
def export(
    job: Annotated[
        str,
        typer.Argument(metavar="ID|FOLDER", help="A job's id or its beginning, or a folder that `run --out` wrote."),
    ],
    to: Annotated[
        Path | None,
        typer.Option(
            "--out", help="A file that ends in .zip, or a new folder. Default: a zip file named after the job."
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    as_json: JsonOption = False,
) -> None:
    """Take a finished job along: scenes as glTF, light and normals, images, parameters with names and units."""
    from scene_attack.errors import InvalidRequest

    folder = Path(job)
    local = folder.is_dir()
    if not local and ("/" in job or folder.exists()):
        raise InvalidRequest("ID|FOLDER", f"{job} is neither the id of a job nor a folder that `run --out` wrote")
    if to is not None and to.suffix != ".zip" and to.exists() and (not to.is_dir() or any(to.iterdir())):
        raise InvalidRequest(
            "--out", f"{to} is there already, and no empty folder; name another, or a file ending in .zip"
        )
    written = _export_folder(folder, to) if local else _export_job(job, to, url)
    print_found({"written": str(written)}, f"Written to {written}", as_json)


def _export_folder(folder: Path, to: Path | None) -> Path:
    """Exports a result folder into a zip file, whose files are in a folder of its own, or into a folder; returns it."""
    from scene_attack import disk
    from scene_attack.cli.commands.run import library
    from scene_attack.cli.progress import JobLine
    from scene_attack.runs.environment import options_to_run

    options = options_to_run()
    name = f"{folder.resolve().name}-export"
    to = to or Path(f"{name}.zip")
    with JobLine(str(folder)) as line:
        line.update("loading", 0, 1, None)
        assets = library(options)
        with extra("export", "scene-attack export"):
            from scene_attack.export.bundle import into_folder, write_bundle, zipped

        files = {path.name: path.read_bytes for path in folder.iterdir() if path.is_file()}
        if to.suffix != ".zip":
            write_bundle(files, assets, into_folder(to))
            return to
        with disk.replacing(to) as part, part.open("wb") as file, zipped(file, name) as write:
            write_bundle(files, assets, write)
    return to


def _export_job(job: str, to: Path | None, url: str) -> Path:
    """Writes what the service exports into a zip file or a folder; returns it."""
    from tempfile import TemporaryDirectory
    from zipfile import ZipFile

    from scene_attack.client import operations
    from scene_attack.client.client import Client

    with extra("export", "scene-attack export"):
        from scene_attack.export.bundle import into_folder
    from scene_attack.scenes.bundle import clean_name

    with Client(url) as client, TemporaryDirectory() as folder:
        whole = whole_job_id(client, job)
        to = to or Path(f"scene-attack-{whole[:SHORT]}.zip")
        if to.suffix == ".zip":
            client.save(operations.download_export(whole), to)
            return to
        archive = Path(folder) / "export.zip"
        client.save(operations.download_export(whole), archive)
        write = into_folder(to)
        with ZipFile(archive) as zipped:
            for name in zipped.namelist():
                # A service can name no file outside the folder.
                write(clean_name(name.partition("/")[2]), zipped.read(name))
    return to
