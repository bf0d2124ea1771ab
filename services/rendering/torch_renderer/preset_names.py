"""The names of the DSBRDF presets, and what is stored of each. It needs no torch: the API checks requests by it."""

import json
from functools import lru_cache
from importlib.resources import files
from typing import Any

from services.errors import InvalidRequest
from services.text import did_you_mean


@lru_cache(maxsize=1)
def stored_presets() -> dict[str, dict[str, Any]]:
    """Returns the fits of all presets by name, as presets.json has them."""
    text = files("services.rendering.torch_renderer").joinpath("presets.json").read_text()
    found: dict[str, dict[str, Any]] = json.loads(text)["presets"]
    return found


def check_preset(name: str, field: str = "material") -> None:
    """Raises InvalidRequest(field, …) with the nearest names for an unknown name."""
    known = stored_presets()
    if name not in known:
        hint = did_you_mean(name, known) or f"; there are {', '.join(known)}"
        raise InvalidRequest(field, f"there is no material preset {name!r}{hint}")
