"""Options of several commands, and ids, of which the beginning stands for the whole one, as git has it for commits."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from scene_attack.errors import InvalidRequest

if TYPE_CHECKING:
    from scene_attack.client.client import Client
    from scene_attack.client.schemas import CampaignSummary, JobSummary

SpecArgument = Annotated[str, typer.Argument(metavar="SPEC", help="A job as JSON; - reads it from stdin.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
DataOption = Annotated[
    Path | None, typer.Option("--data", help="Directory of database, artifacts and uploads [SCENE_ATTACK_DATA].")
]
SeedOption = Annotated[int | None, typer.Option("--seed", min=0, help="Use this seed instead of the spec's.")]
PriorityOption = Annotated[
    Literal["high", "normal", "low"] | None,
    typer.Option("--priority", help="Jobs of a higher priority are taken first; default: normal, of campaigns low."),
]
UrlOption = Annotated[str, typer.Option("--url", envvar="SCENE_ATTACK_URL", help="URL of the service.")]


SHORT = 8
"""Digits of an id that tables show."""
WHOLE = 32
"""Digits of an id."""
MAX_LISTED = 10
"""Ids that a message about an ambiguous beginning lists."""


def whole_job_id(client: "Client", text: str) -> str:
    """The id of the job that `text` is, or is the beginning of. Raises InvalidRequest("ID") if that is not one job."""
    digits = _digits(text, "job")
    return digits if len(digits) == WHOLE else _only(client.list_jobs(q=f"id:{digits}"), digits, "job")


def whole_campaign_id(client: "Client", text: str) -> str:
    """As `whole_job_id`, of a campaign."""
    digits = _digits(text, "campaign")
    return digits if len(digits) == WHOLE else _only(client.list_campaigns(), digits, "campaign")


def _digits(text: str, kind: str) -> str:
    digits = text.strip().rstrip("….").lower()
    if not re.fullmatch("[0-9a-f]{1,32}", digits):
        raise InvalidRequest(
            "ID", f"{text!r} is no id of a {kind}: those are 32 digits of 0-9 and a-f, or the first few"
        )
    return digits


def _only(items: "Iterable[JobSummary | CampaignSummary]", digits: str, kind: str) -> str:
    matches = [item for item in items if item.id.startswith(digits)]
    if not matches:
        raise InvalidRequest("ID", f"there is no {kind} whose id begins with {digits!r}")
    if len(matches) > 1:
        listed = ", ".join(f"{item.id[: max(SHORT, len(digits) + 4)]} ({item.name})" for item in matches[:MAX_LISTED])
        more = f" and {len(matches) - MAX_LISTED} more" if len(matches) > MAX_LISTED else ""
        message = f"{digits!r} is the beginning of {len(matches)} ids: {listed}{more}; give more digits"
        raise InvalidRequest("ID", message)
    return matches[0].id
