"""The query parameters of a submission that are no part of the request: they change when and where a job runs only."""

from collections.abc import Callable
from typing import Annotated

from fastapi import Query

from services.jobs.placement import Demand, Device, Priority

LARGEST = 2**50
"""Most bytes of memory that a client may ask for; far more than any machine has."""


def demand(default: Priority) -> Callable[..., Demand]:
    """Returns a dependency that reads what a submission asks of the queue."""

    def read(
        priority: Annotated[
            Priority, Query(description="jobs of a higher priority are taken first; within one, owners take turns")
        ] = default,
        device: Annotated[
            Device | None, Query(description="kind of device that the worker must have; default: any")
        ] = None,
        memory: Annotated[
            int, Query(ge=0, le=LARGEST, description="bytes of memory that the worker must allow a job")
        ] = 0,
    ) -> Demand:
        return Demand(priority, device, memory)

    return read
