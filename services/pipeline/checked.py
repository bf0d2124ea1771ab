"""What the check of a request found. It needs no torch, so that the API can import it."""

from dataclasses import dataclass

from services.pipeline.result import JobWarning
from services.pipeline.spec import JobSpec


@dataclass(frozen=True)
class Checked:
    """A request that can run: its spec as it would run, and what its sender is warned of."""

    spec: JobSpec
    warnings: tuple[JobWarning, ...]
