"""The command line `scene-attack`. Its exit code is 0 on success, 1 on failure, 2 for bad input.

Other packages add commands by an entry point of the group `scene_attack.commands`: a function of the Typer app.
"""

import os
import sys
from importlib.metadata import entry_points
from typing import Annotated, NoReturn

import typer

from scene_attack.cli.commands import analyse, assets, campaign, doctor, export, jobs, run, scene, targets
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.extras import MissingExtra, extra

app = typer.Typer(
    name="scene-attack",
    help="Finds out how a vision model fails when the scene changes a little: its light, a surface, a colour, a pose.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"scene-attack {version('scene-attack')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    without_plugin: Annotated[
        list[str] | None,
        typer.Option("--without-plugin", metavar="NAME", help="Leave out an installed plug-in; may be repeated."),
    ] = None,
) -> None:
    del version  # its callback ends the program
    if without_plugin:
        os.environ["SCENE_ATTACK_WITHOUT_PLUGINS"] = ",".join(without_plugin)


for part in (run.app, analyse.app, export.app, jobs.submitting, doctor.app):
    app.add_typer(part)
app.add_typer(jobs.app, name="jobs")
app.add_typer(campaign.app, name="campaign")
app.add_typer(assets.app, name="assets")
app.add_typer(scene.app, name="scene")
app.add_typer(targets.app, name="targets")
for entry in sorted(entry_points(group="scene_attack.commands")):
    entry.load()(app)


def main() -> None:
    """Runs the command line. An expected error becomes a line on stderr for each wrong field, and an exit code."""
    try:
        # The commands of the service are always listed; each imports what it runs when it is called.
        with extra("service", " ".join(["scene-attack", *sys.argv[1:2]])):
            app(prog_name="scene-attack")
    except KeyboardInterrupt:
        _end(130, "interrupted")
    except MissingExtra as error:
        _end(2, error.detail)
    except InvalidRequest as error:
        _end(2, *(f"bad input: {wrong.field}: {wrong.detail}" for wrong in error.every))
    except JobFailure as error:
        _end(1, f"failed ({error.kind}): {error.detail}")
    except Exception as error:
        _end_with(error)


def _end_with(error: Exception) -> NoReturn:
    """Ends with a message for a bad setting or an error of a service; raises any other error again."""
    from httpx import HTTPError

    from scene_attack.client.errors import ApiError, why

    if isinstance(error, ApiError):
        hint = "; the command line sends the one in SCENE_ATTACK_KEY" if error.status == 401 else ""
        code = 2 if 400 <= error.status < 500 else 1
        _end(code, *(f"refused: {message}{hint}" for message in error.fields or [str(error)]))
    if isinstance(error, HTTPError):
        _end(1, why(error))
    if isinstance(error, OSError) and error.strerror:  # a full disk, a folder that cannot be written, a store
        name = f": {error.filename}" if error.filename else ""
        _end(1, f"failed: {error.strerror}{name}")
    if _is_outage(error):
        reason = str(error.__cause__ or error).splitlines()[0]
        _end(1, f"the database does not answer ({reason}); scene-attack doctor says what to do")
    raise error


def _is_outage(error: Exception) -> bool:
    # A program that has not imported the database has not asked it.
    database = sys.modules.get("sqlalchemy.exc")
    return database is not None and isinstance(error, database.OperationalError)


def _end(code: int, *messages: str) -> NoReturn:
    from scene_attack.text import visible

    for message in messages:
        print(f"scene-attack: {visible(message)}", file=sys.stderr)
    sys.exit(code)
