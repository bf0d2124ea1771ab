"""Finds the job or campaign that the beginning of an id names, as git does for commits."""

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from services.errors import InvalidRequest

if TYPE_CHECKING:
    from client.api_client import ApiClient

SHORT = 8
"""Digits of an id that tables show."""
MAX_LISTED = 10
"""Ids that a message about an ambiguous beginning lists."""
PAGE = 200
Page = Mapping[str, Any]


def job_id(client: "ApiClient", text: str) -> str:
    """The id of the job that `text` is, or is the beginning of. Raises InvalidRequest("ID") if that is not one job."""
    return _whole(text, "job", lambda digits, cursor: client.list_jobs(PAGE, cursor=cursor, q=f"id:{digits}"))


def campaign_id(client: "ApiClient", text: str) -> str:
    """As `job_id`, of a campaign."""
    return _whole(text, "campaign", lambda _, cursor: client.list_campaigns(PAGE, cursor))


def _whole(text: str, kind: str, page: Callable[[str, str | None], Page]) -> str:
    digits = text.strip().rstrip("….").lower()
    if not re.fullmatch("[0-9a-f]{1,32}", digits):
        raise InvalidRequest(
            "ID", f"{text!r} is no id of a {kind}: those are 32 digits of 0-9 and a-f, or the first few"
        )
    if len(digits) == 32:
        return digits
    found: list[Mapping[str, Any]] = []
    cursor = None
    while True:
        one = page(digits, cursor)
        found += [item for item in one["items"] if item["id"].startswith(digits)]
        cursor = one["next"]
        if cursor is None:
            break
    if not found:
        raise InvalidRequest("ID", f"there is no {kind} whose id begins with {digits!r}")
    if len(found) > 1:
        listed = ", ".join(
            f"{item['id'][: max(SHORT, len(digits) + 4)]} ({item['name']})" for item in found[:MAX_LISTED]
        )
        more = f" and {len(found) - MAX_LISTED} more" if len(found) > MAX_LISTED else ""
        raise InvalidRequest("ID", f"{digits!r} is the beginning of {len(found)} ids: {listed}{more}; give more digits")
    return str(found[0]["id"])
