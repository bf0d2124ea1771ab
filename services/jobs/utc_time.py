"""The type of the record's times, and places in lists that are sorted by them."""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import DateTime, Dialect, TypeDecorator, literal, tuple_
from sqlalchemy.sql.elements import ColumnElement


class UtcTime(TypeDecorator[datetime]):
    """A column of aware UTC datetimes. SQLite stores no time zone, so it is removed on writing and added on reading."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Converts an aware datetime to the naive UTC time that the database stores."""
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Converts the naive UTC time of the database to an aware datetime."""
        return None if value is None else value.replace(tzinfo=UTC)


def place(before: tuple[datetime, str]) -> ColumnElement[Any]:
    """A (created_at, id) as SQL. The time has the columns' type: PostgreSQL would compare an aware datetime with a
    column that has no time zone in the zone of the session.
    """
    return tuple_(literal(before[0], UtcTime()), before[1])
