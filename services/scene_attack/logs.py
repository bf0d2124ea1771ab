"""Structured logs of the service's processes: a line per event, as JSON unless stderr is a terminal.

On a terminal a line has the time of day, the level, the event and its values, for a person to read.
"""

import logging
import sys
from collections.abc import MutableMapping
from contextlib import AbstractContextManager
from typing import Any

import structlog


def configure(process: str) -> None:
    """Sends structlog's and the standard library's records to stderr, each with the name of the process."""

    def name(_logger: Any, _method: str, record: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        return {"process": process, **record}

    shared: list[Any] = [structlog.contextvars.merge_contextvars, name, structlog.stdlib.add_log_level]
    renderer: Any = structlog.processors.JSONRenderer()
    if sys.stderr.isatty():
        shared.append(structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False))
        # The default shows local variables, which may be keys and passwords.
        plain = structlog.dev.plain_traceback
        renderer = structlog.dev.ConsoleRenderer(exception_formatter=plain, pad_event_to=0)
    else:
        shared.append(structlog.stdlib.add_logger_name)
        shared.append(structlog.processors.TimeStamper(fmt="iso", utc=True))
        shared.append(structlog.processors.format_exc_info)
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.stdlib.PositionalArgumentsFormatter(),
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=True,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.INFO)
    for chatty in ("httpx", "alembic", "OpenGL"):
        logging.getLogger(chatty).setLevel(logging.WARNING)


def bound(**ids: Any) -> AbstractContextManager[None]:
    """Every line that is logged inside the context carries these ids, e.g. `with bound(job=id, attempt=2):`."""
    return structlog.contextvars.bound_contextvars(**ids)


def logger(name: str) -> Any:
    """Returns a structured logger; usage: `log.info("job taken", job=id)`."""
    return structlog.get_logger(name)
