"""The type of the record's times."""

from datetime import UTC, datetime

from sqlalchemy import DateTime, Dialect, TypeDecorator


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
