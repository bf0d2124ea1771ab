"""`scene-attack`: the front door. Exit codes: 0 done, 1 failed, 2 bad input."""

import sys
from typing import Annotated

import typer

from client.commands import assets, demo, jobs, run, serve, submit
from services.errors import InvalidRequest, JobFailure

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
) -> None:
    pass


run.register(app)
submit.register(app)
app.add_typer(jobs.app, name="jobs")
app.add_typer(assets.app, name="assets")
assets.register(app)
serve.register(app)
demo.register(app)


def main() -> None:
    """Runs the command line; errors become one line on stderr and an exit code."""
    from httpx import HTTPError

    from client.api_client import ApiError

    try:
        app()
    except InvalidRequest as error:
        _say(f"bad input: {error.field}: {error.detail}")
        sys.exit(2)
    except ApiError as error:
        _say(str(error))
        sys.exit(2 if error.status in (400, 404, 409, 413, 415, 422) else 1)
    except JobFailure as error:
        _say(f"the job failed ({error.kind}): {error.detail}")
        sys.exit(1)
    except HTTPError as error:
        _say(f"no answer from the service: {error or type(error).__name__} (is `scene-attack serve` running there?)")
        sys.exit(1)
    except KeyboardInterrupt:
        _say("interrupted")
        sys.exit(130)


def _say(message: str) -> None:
    print(f"scene-attack: {message}", file=sys.stderr)
