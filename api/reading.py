"""Short reads of the record, for the requests that come most often."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool

from services.jobs.database import READS_SQLITE

P = ParamSpec("P")
T = TypeVar("T")


class Reading:
    """Reads by an index, of a few rows: in the event loop if the record is SQLite's, which is part of this process,
    and in a thread otherwise.

    Such a read takes less time than its way to a thread and back while the processor is busy. If a thread is reading at
    the moment, which may take long, the event loop does not wait for it and hands the read over, too.
    """

    def __init__(self, engine: Engine) -> None:
        self._is_here = engine.dialect.name == "sqlite"

    async def __call__(self, read: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Returns what the function `read` returns."""
        if self._is_here and not READS_SQLITE.locked():
            return read(*args, **kwargs)
        return await run_in_threadpool(read, *args, **kwargs)
