"""What lists show of a request and of its outcome, in columns of the job, so that no list reads a whole request."""

from collections.abc import Mapping
from typing import Any

from services.attacks.verdict import SUCCESS, with_outcome
from services.pipeline.names import attack_name, job_name, question_names, scene_name

LONGEST = 300
"""Characters of a listed text; a scene may have many meshes. Longer ones end in an ellipsis."""


def listed(spec: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> dict[str, str | None]:
    """The listed columns of the full spec of an attack or re-rendering, by name; `titles` are those of uploads, by
    their names in scenes.
    """
    questions = question_names(spec)
    if "fit" in spec:
        work = {"attack": "re-rendering", "renderer": "torch", "method": f"fit by {spec['fit']['optimiser']}"}
    else:
        attack = spec["attack"]
        work = {"attack": attack_name(spec), "renderer": attack["renderer"], "method": attack["method"]}
    columns = {
        "name": job_name(spec, titles),
        "scene": scene_name(spec, titles),
        **work,
        "target": spec["target"]["name"],
        "question": questions[0] if questions else None,
    }
    return {column: _cut(text) for column, text in columns.items()}


def listed_outcome(outcome: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of an outcome (services.pipeline.outcome) that lists sort and filter by; p is the paper's, or that of
    the saved image in results of version 0.1.
    """
    record = with_outcome(outcome)
    paper = record.get("float_perceptibility")
    return {
        "verdict": record["outcome"],
        "verified": record["outcome"] == SUCCESS and bool(record.get("verified")),
        "p": record.get("perceptibility") if paper is None else paper,
        "queries": record.get("queries"),
        "seconds": record.get("seconds"),
    }


def _cut(text: str | None) -> str | None:
    return text if text is None or len(text) <= LONGEST else text[: LONGEST - 1] + "…"
