"""Finds the job or campaign that the beginning of an id names, as git does for commits."""

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from services.errors import InvalidRequest

if TYPE_CHECKING:
    from api.schemas import CampaignSummary, JobSummary
    from client.client import Client

SHORT = 8
"""Digits of an id that tables show."""
WHOLE = 32
"""Digits of an id."""
MAX_LISTED = 10
"""Ids that a message about an ambiguous beginning lists."""


def job_id(client: "Client", text: str) -> str:
    """The id of the job that `text` is, or is the beginning of. Raises InvalidRequest("ID") if that is not one job."""
    digits = _digits(text, "job")
    return digits if len(digits) == WHOLE else _only(client.list_jobs(q=f"id:{digits}"), digits, "job")


def campaign_id(client: "Client", text: str) -> str:
    """As `job_id`, of a campaign."""
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
