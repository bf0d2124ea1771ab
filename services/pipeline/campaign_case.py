"""Turns the result of a job into a case of a campaign's table, and compares results to reuse them."""

import hashlib
import json
from typing import Any

from services.analysis.campaign_curves import Curves
from services.analysis.campaign_table import Case
from services.pipeline.outcome import success
from services.pipeline.result import Provenance, Result
from services.pipeline.spec import JobSpec, digest
from services.rendering.declaration import IMAGE_OF

_NOT_IDENTITY = ("seed", "credits", "extensions")
"""Fields of the provenance that belong to the request, or change no bits, or are compared otherwise."""


def identity(provenance: Provenance, label: str, confidence: float) -> str:
    """Hex SHA-256 of what a result's bits depend on besides the request, and of the network's first answer.

    The provenance has assets, weights, backend and versions. The answer tells networks apart whose weights are not at
    hand to be hashed: those behind a URL, or inside a factory's object.
    """
    values = provenance.model_dump(mode="json", exclude=set(_NOT_IDENTITY))
    values["first_answer"] = [label, confidence]
    # the same picture, whether a renderer draws it or its pixels are attacked
    values["backend"] = provenance.backend.removeprefix(IMAGE_OF)
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def reusable(result: Result, request: str, wanted: str | None) -> bool:
    """Whether the result is that of the request with this digest, and of inputs and backend of identity `wanted`.

    The result of an extension's attack is not: its file may have changed since the first answers were found.
    """
    return (
        wanted is not None
        and not result.provenance.extensions
        and identity(result.provenance, result.original.label, result.original.confidence) == wanted
        and digest(JobSpec.model_validate(result.spec)) == request
    )


def case_of(result: Result, target: str, attack: str, *, run_seconds: float | None, reused: bool) -> Case:
    """The case of a job that ran to its end."""
    right = bool(result.right_before)
    rows = [row for row in result.trace if row.step == result.step]
    return Case(
        target=target,
        attack=attack,
        state="succeeded",
        right=right,
        outcome=result.outcome,
        epsilon_bound=result.epsilon_bound,
        success=success(result),
        loop_success=right and result.fooled,
        perceptibility=result.perceptibility if result.float_perceptibility is None else result.float_perceptibility,
        loop_perceptibility=rows[-1].perceptibility if rows else None,
        truncated=result.truncated,
        queries=result.queries,
        seconds=result.seconds,
        run_seconds=run_seconds,
        reused=reused,
    )


def unfinished(target: str, attack: str, state: str, *, right: bool) -> Case:
    """The case of a job that failed or was cancelled; `right` says whether the network's first answer was right."""
    return Case(target=target, attack=attack, state=state, right=right)


def curves_of(result: Result) -> Curves:
    """The curves of a result's trace."""
    return Curves(
        loss=[row.loss for row in result.trace],
        advantage=[row.advantage for row in result.trace],
        distance=[row.distance for row in result.trace],
    )


def curves_record(curves: Curves) -> dict[str, Any]:
    """The curves as JSON with six significant digits, which is what a drawing can show."""
    return {name: [float(f"{value:.6g}") for value in values] for name, values in curves.model_dump().items()}
