"""The commands `keys`: make, list and revoke the keys of a service, in its database."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scene_attack.cli.commands.options import DataOption, JsonOption
from scene_attack.cli.console import FittedTable, print_found, print_json, remark, say

if TYPE_CHECKING:
    from scene_attack_service.access.keys import AccessKey, AccessKeys
    from scene_attack_service.settings import Settings

app = typer.Typer(
    help="Make, list and revoke the keys of a service. Works on the database that SCENE_ATTACK_DATA or "
    "SCENE_ATTACK_DATABASE_URL names, also while the service runs. Of a service that has --data, give it here too.",
    no_args_is_help=True,
)

DEFAULT_SCOPES = ("jobs:read", "jobs:write", "assets:write")
LONGEST = 100
DAY = 24 * 60 * 60.0
MOST_DAYS = 36_500


@app.command(
    epilog="Examples: [bold]scene-attack keys create alice[/bold]\n\n"
    "[bold]scene-attack keys create ci --owner alice --scope jobs:write --scope jobs:read --days 90[/bold]\n\n"
    "[bold]scene-attack keys create operator --scope admin[/bold]"
)
def create(
    name: Annotated[str, typer.Argument(help="What the key is for, as lists show it.")],
    scope: Annotated[
        list[str] | None,
        typer.Option(
            help="What the key allows: jobs:read, jobs:write, assets:write, metrics:read or admin, which is everything "
            "for all owners. May be repeated; without it the first three."
        ),
    ] = None,
    owner: Annotated[
        str | None,
        typer.Option(help="Whose jobs, campaigns and meshes the key makes and sees; without it, NAME is the owner."),
    ] = None,
    days: Annotated[float | None, typer.Option(help="The key expires after this time.")] = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a key and print its text, which is not kept: copy it now. Programs send it from SCENE_ATTACK_KEY.

    From the first key on, the service answers nobody without one, on this machine either.
    """
    from scene_attack.errors import InvalidRequest
    from scene_attack_service.access.caller import Scope
    from scene_attack_service.settings import read_settings

    known = [choice.value for choice in Scope]
    for word in scope or ():
        if word not in known:
            raise InvalidRequest("--scope", f"{word!r} is no scope; it is one of {', '.join(known)}")
    name, owner = _word("NAME", name), _word("--owner", name if owner is None else owner, least=0)
    if days is not None and not 0 < days <= MOST_DAYS:
        raise InvalidRequest("--days", f"must be more than 0 and at most {MOST_DAYS:,}, not {days:g}")
    settings = read_settings(data=data)
    with _keys(settings) as keys:
        scopes = {Scope(word) for word in scope or DEFAULT_SCOPES}
        key, text = keys.create(name, owner, scopes, None if days is None else days * DAY)
    if as_json:
        print_json(_shown(key) | {"key": text})
        return
    say(text)
    remark(f"This is the only time that the key {key.prefix} is shown. It is in {_place(settings)}.")


@app.command("list", epilog="Example: [bold]scene-attack keys list[/bold]")
def list_keys(data: DataOption = None, as_json: JsonOption = False) -> None:
    """List all keys, oldest first, also those that are revoked or have expired. No key's text is known."""
    from scene_attack_service.settings import read_settings

    with _keys(read_settings(data=data)) as keys:
        all_keys = [_shown(key) for key in keys.all()]
    columns = ("prefix", "name", "owner", "scopes", "state", "expires", "created", "last used")
    rows = [
        [key["prefix"], key["name"], key["owner"], " ".join(key["scopes"]), key["state"]]
        + [(key[time] or "never")[:16] for time in ("expires", "created", "last_used")]
        for key in all_keys
    ]
    print_found(all_keys, FittedTable(columns, rows, spare=("created", "last used", "owner", "expires")), as_json)


@app.command(epilog="Example: [bold]scene-attack keys revoke sa_1f0c9a7b3e[/bold]")
def revoke(
    prefix: Annotated[str, typer.Argument(metavar="PREFIX", help="The key's prefix, from `keys list`.")],
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """End a key for good. Its next request is refused, and its sessions of the dashboard end."""
    from scene_attack.errors import InvalidRequest
    from scene_attack_service.settings import read_settings

    settings = read_settings(data=data)
    with _keys(settings) as keys:
        key = keys.revoke(prefix)
    if key is None:
        raise InvalidRequest(
            "PREFIX", f"there is no key {prefix!r} in {_place(settings)}; `keys list` shows all of them"
        )
    print_found(_shown(key), f"{key.prefix}  revoked", as_json)


@contextmanager
def _keys(settings: "Settings") -> "Iterator[AccessKeys]":
    """The keys in the settings' database."""
    from scene_attack_service.access.keys import AccessKeys
    from scene_attack_service.jobs.database import connect, migrate

    engine = connect(settings)
    try:
        migrate(engine, settings)
        yield AccessKeys(engine)
    finally:
        engine.dispose()


def _place(settings: "Settings") -> str:
    """Where the keys are, in words. The URL of a database may have a password and is not shown."""
    return str(settings.data_dir) if settings.database_url is None else "the database of SCENE_ATTACK_DATABASE_URL"


def _word(field: str, text: str, least: int = 1) -> str:
    from scene_attack.errors import InvalidRequest
    from scene_attack.text import line_or_nothing

    if not least <= len(text) <= LONGEST:
        raise InvalidRequest(field, f"it has {least} to {LONGEST} characters")
    try:
        return line_or_nothing(text)
    except ValueError as error:
        raise InvalidRequest(field, str(error)) from error


def _shown(key: "AccessKey") -> dict[str, Any]:
    expired = key.expires_at is not None and key.expires_at <= datetime.now(UTC)
    return {
        "prefix": key.prefix,
        "name": key.name,
        "owner": key.owner,
        "scopes": key.scopes,
        "state": "revoked" if key.revoked_at is not None else "expired" if expired else "valid",
        "created": _time(key.created_at),
        "last_used": _time(key.last_used_at),
        "expires": _time(key.expires_at),
        "revoked": _time(key.revoked_at),
    }


def _time(time: datetime | None) -> str | None:
    return None if time is None else time.isoformat(timespec="seconds")
