"""One stiff or extreme case: its difficulty, the property that must hold, and the measurement that shows it."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.errors import InvalidRequest, JobFailure

Outcome = Literal["ok", "flat", "clipped", "refused", "failed"]


class Broken(AssertionError):
    """A property that must hold does not."""


def need(holds: bool, otherwise: str) -> None:
    """Raises Broken(otherwise) unless it holds."""
    if not holds:
        raise Broken(otherwise)


def largest(values: Any) -> float:
    """The largest magnitude of a tensor or an array; NaN if a value is."""
    return float(abs(values).max())


@dataclass(frozen=True)
class Measured:
    """A measured `value`, which must be at most `limit`; `what` names the quantity and its reference."""

    value: float
    limit: float
    what: str


@dataclass(frozen=True)
class Case:
    """One row of the report.

    `measure` raises Broken where the property does not hold and returns the number that shows that it does. `held` says
    how it holds: "ok"; "flat", where the method must say that it learnt nothing; "clipped", where values must be held
    at a bound. With a `refusal`, the field of the InvalidRequest or the kind of the JobFailure, one must be raised.
    `slow` cases are left out of the quick report.
    """

    name: str
    stiff: str
    must: str
    measure: Callable[[], Measured]
    held: Literal["ok", "flat", "clipped"] = "ok"
    refusal: str | None = None
    slow: bool = False
    family: str = ""
    """Set when the families are put together (`report.cases`)."""

    @property
    def outcome(self) -> Outcome:
        """The outcome that the case must have."""
        return self.held if self.refusal is None else "refused"


def case(
    name: str,
    stiff: str,
    must: str,
    measure: Callable[..., Measured],
    *arguments: Any,
    held: Literal["ok", "flat", "clipped"] = "ok",
    refusal: str | None = None,
    slow: bool = False,
    **named: Any,
) -> Case:
    """The case that is measured by `measure(*arguments, **named)`."""
    return Case(name, stiff, must, partial(measure, *arguments, **named), held, refusal, slow)


class Observation(BaseModel):
    """The result of a case."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    family: str
    stiff: str = Field(description="what is stiff or extreme")
    must: str = Field(description="the property that must hold")
    outcome: Outcome
    what: str = Field(description="what was measured, against which reference; or the words of the refusal")
    measured: float | None = Field(description="None for a refusal")
    tolerance: float | None


def observe(case: Case) -> Observation:
    """Runs a case. Any error other than the refusal that the case expects is a failure; so is a numpy warning of an
    overflow or of an invalid operation."""
    measured = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            measured = case.measure()
        outcome, what = _judged(case, measured)
    except (InvalidRequest, JobFailure) as error:
        named = error.field if isinstance(error, InvalidRequest) else error.kind
        as_wanted = case.refusal is not None and named == case.refusal and bool(error.detail)
        outcome = "refused" if as_wanted else "failed"
        what = f"{named}: {error.detail}" if as_wanted else f"refused unexpectedly, {named}: {error.detail}"
    except Broken as broken:
        outcome, what = "failed", str(broken)
    except Exception as error:  # the report says what went wrong, and the others go on
        outcome, what = "failed", f"{type(error).__name__}: {error}"
    return Observation(
        name=case.name,
        family=case.family,
        stiff=case.stiff,
        must=case.must,
        outcome=outcome,
        what=what,
        measured=None if measured is None else measured.value + 0.0,  # never −0
        tolerance=None if measured is None else measured.limit,
    )


def _judged(case: Case, measured: Measured) -> tuple[Outcome, str]:
    if case.refusal is not None:
        return "failed", f"not refused; {measured.what}: {measured.value:g}"
    if not measured.value <= measured.limit:  # NaN is a failure too
        return "failed", f"{measured.what}: {measured.value:g}, more than {measured.limit:g}"
    return case.held, measured.what
