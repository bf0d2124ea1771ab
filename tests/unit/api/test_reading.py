"""Where short reads of the record run."""

import threading
from typing import cast

import pytest
from sqlalchemy import Engine, create_engine

from api.requests import Reading
from services.jobs.database import READS_SQLITE

pytestmark = [pytest.mark.slow, pytest.mark.anyio]
SQLITE = create_engine("sqlite://")


class _PostgreSQL:
    """What `Reading` asks of an engine."""

    class dialect:  # noqa: N801
        name = "postgresql"


async def _thread(engine: object) -> threading.Thread:
    return await Reading(cast(Engine, engine))(threading.current_thread)


async def test_a_record_of_this_process_is_read_here() -> None:
    assert await _thread(SQLITE) is threading.current_thread()


async def test_the_event_loop_does_not_wait_for_a_thread_that_reads() -> None:
    with READS_SQLITE:
        assert await _thread(SQLITE) is not threading.current_thread()


async def test_another_machine_is_asked_in_a_thread() -> None:
    assert await _thread(_PostgreSQL) is not threading.current_thread()


async def test_arguments_and_errors_are_handed_on() -> None:
    assert await Reading(SQLITE)(int, "ff", base=16) == 255
    with pytest.raises(ValueError, match="invalid literal"):
        await Reading(SQLITE)(int, "x")
