"""What kind of answer a client asks for."""

import re

from starlette.datastructures import Headers
from starlette.types import Scope

_HTML = re.compile(r"(?:^|,)\s*text/html\s*(?:;(?!\s*q=0(?:\.0*)?\s*(?:,|$))[^,]*)?(?:,|$)", re.IGNORECASE)


def asks_for_html(scope: Scope) -> bool:
    """Whether the request's Accept header has HTML by its name, as a browser's has. A program that takes anything does
    not ask for it.
    """
    return _HTML.search(Headers(scope=scope).get("accept", "")) is not None
