"""INSERT statements that may say ON CONFLICT, which SQLite and PostgreSQL both have and standard SQL has not."""

from typing import Any

from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

_INSERT: dict[str, Any] = {"sqlite": sqlite.insert, "postgresql": postgresql.insert}


def insert(session: Session, table: type) -> Any:
    """An INSERT into a model's table, of the dialect of the session's database."""
    return _INSERT[session.get_bind().dialect.name](table)
