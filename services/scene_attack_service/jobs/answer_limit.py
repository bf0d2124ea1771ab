"""Connections to PostgreSQL that wait for a limited time: for its answers, for locks, and for their own next statement.

A database that is stopped keeps its connections open and says nothing, and so does a process of the service that is
stopped within a transaction: others would wait for it for ever.
"""

from typing import Any

import psycopg
from psycopg.abc import RV, PQGen
from psycopg.pq import TransactionStatus


class LimitedConnection(psycopg.Connection[Any]):
    """A connection on which a statement may take `answer_seconds`; None: as long as it takes."""

    answer_seconds: float | None = None

    def wait(self, gen: PQGen[RV], interval: float = 0.1, timeout: float | None = None) -> RV:
        """Waits for an answer. Raises OperationalError, and closes the connection, if it takes too long."""
        try:
            return super().wait(gen, interval, self.answer_seconds if timeout is None else timeout)
        except psycopg.OperationalError:
            if self.pgconn.transaction_status == TransactionStatus.ACTIVE:
                self.pgconn.finish()  # the answer may come yet, and would be taken for that to the next statement
            raise


def limited(lock_seconds: float, arguments: dict[str, Any]) -> LimitedConnection:
    """Connects with libpq's `arguments`. A statement waits `lock_seconds` for a lock and half as long again for its
    answer. A transaction that says nothing for so long is rolled back by the server.
    """
    patience = 1.5 * lock_seconds
    limits = {"lock_timeout": lock_seconds, "idle_in_transaction_session_timeout": patience}
    settings = " ".join(f"-c {name}={round(1000 * seconds)}" for name, seconds in limits.items())
    options = {"options": f"{arguments.get('options', '')} {settings}".strip()}
    connection = LimitedConnection.connect(**arguments | options)
    connection.answer_seconds = patience
    return connection
