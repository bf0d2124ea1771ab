"""Settings that a request leaves out and the renderer suggests for its groups. This module does not import torch."""

from collections.abc import Callable
from typing import Any

from services.rendering.declaration import RENDERERS, Group


def suggested(data: dict[str, Any], field: str, suggestion: Callable[[Group], float | None]) -> dict[str, Any]:
    """Request data with the groups that `field`, an object by group, leaves out filled in by `suggestion`.

    Data that is invalid is returned as it is; the field's own validation refuses it.
    """
    renderer = RENDERERS.get(str(data.get("renderer")))
    given = data.get(field) or {}
    if renderer is None or not isinstance(given, dict):
        return data
    values = {group.name: suggestion(group) for group in renderer.groups if group.name in data["groups"]}
    return data | {field: {group: value for group, value in values.items() if value is not None} | given}


def suggested_limits(data: dict[str, Any]) -> dict[str, Any]:
    """Request data with each attacked group's `epsilon`, by default the limit that the renderer suggests."""
    return suggested(data, "epsilon", lambda group: group.suggested_limit)
