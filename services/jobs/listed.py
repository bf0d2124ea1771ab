"""What lists show of a request. It is kept in columns of the job, so that no list reads a whole request."""

from collections.abc import Mapping
from typing import Any

from services.pipeline.names import attack_name, job_name, question_names, scene_name

LONGEST = 300
"""Characters of a listed text; a scene may have many meshes. Longer ones end in an ellipsis."""


def listed(spec: Mapping[str, Any]) -> dict[str, str | None]:
    """The listed columns of a full spec, by name."""
    attack, questions = spec["attack"], question_names(spec)
    columns = {
        "name": job_name(spec),
        "scene": scene_name(spec),
        "attack": attack_name(spec),
        "renderer": attack["renderer"],
        "method": attack["method"],
        "target": spec["target"]["name"],
        "question": questions[0] if questions else None,
    }
    return {column: _cut(text) for column, text in columns.items()}


def _cut(text: str | None) -> str | None:
    return text if text is None or len(text) <= LONGEST else text[: LONGEST - 1] + "…"
