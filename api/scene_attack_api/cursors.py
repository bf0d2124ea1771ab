"""The cursors of lists: a place in the list, and of jobs whether the page lies after or before that place."""

import base64
import binascii
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from scene_attack.errors import InvalidRequest
from scene_attack_service.jobs.job_list import SORTS, ListPage, Place
from scene_attack_service.jobs.models import Campaign, State

NEWEST = "-created"
SORT_PATTERN = f"^-?({'|'.join(SORTS)})$"


def _time(value: object) -> datetime:
    time = datetime.fromisoformat(_text(value))
    if time.tzinfo is None:
        raise ValueError("no time zone")
    return time.astimezone(UTC)


def _count(value: object) -> int:
    if not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError("no count")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str) or "\0" in value:
        raise ValueError("no text")
    value.encode()  # raises a ValueError for half a character
    return value


_TYPES: dict[str, Any] = {
    "created": _time,
    "ended": _time,
    "state": State,
    "verified": bool,
    "p": float,
    "queries": _count,
    "seconds": float,
}
"""Types of the values of sorts in a cursor's JSON; those of the other sorts are texts."""


@dataclass(frozen=True)
class Cursor:
    """Place after which a page begins, or before which it ends. At most one of the two is given."""

    after: Place | None = None
    before: Place | None = None


def write_cursor(sort: str, place: Place, *, backwards: bool) -> str:
    """The cursor of the page after a place of a list with this sort, or `backwards` of the page before it."""
    value = place.value.isoformat() if isinstance(place.value, datetime) else place.value
    data = [sort, backwards, value, place.created_at.isoformat(), place.job_id]
    return base64.urlsafe_b64encode(json.dumps(data, ensure_ascii=False).encode()).decode().rstrip("=")


def read_cursor(cursor: str | None, sort: str) -> Cursor:
    """Reads a cursor; None is the first page. Raises InvalidRequest("cursor"), also for that of another sort."""
    if cursor is None:
        return Cursor()
    try:
        data = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode())
        of, backwards, value, created, job_id = data
        if not isinstance(backwards, bool) or not isinstance(job_id, str) or not job_id.isalnum():
            raise ValueError("another kind")
        time = _time(created)
        value = None if value is None else _TYPES.get(sort.removeprefix("-"), _text)(value)
    except (ValueError, TypeError, OverflowError, RecursionError, binascii.Error) as error:
        raise InvalidRequest("cursor", "take it from `next` or `previous` of another page") from error
    if of != sort:
        raise InvalidRequest("cursor", f"it is of the list sorted by {of!r}; begin at the first page of {sort!r}")
    place = Place(value, time, job_id)
    return Cursor(before=place) if backwards else Cursor(after=place)


def page_cursors(page: ListPage, sort: str) -> tuple[str | None, str | None]:
    """The cursors of the pages after and before a page of jobs; None where there is none."""
    after = write_cursor(sort, page.last, backwards=False) if page.last and page.more_after else None
    before = write_cursor(sort, page.first, backwards=True) if page.first and page.more_before else None
    return after, before


def campaign_cursor(campaign: Campaign) -> str:
    """The cursor of the page that begins after this campaign."""
    return write_cursor(NEWEST, Place(campaign.created_at, campaign.created_at, campaign.id), backwards=False)


def read_campaign_cursor(cursor: str) -> tuple[datetime, str]:
    """The (created_at, id) after which the cursor's page begins. Raises InvalidRequest("cursor")."""
    place = read_cursor(cursor, NEWEST).after
    if place is None:
        raise InvalidRequest("cursor", "take it from `next` of the page before")
    return place.created_at, place.job_id
