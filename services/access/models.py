"""The tables of keys, of the sessions that they began, and of who uploaded what."""

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from services.jobs.models import Base


class AccessKey(Base):
    """A key to the API. Only the hash of its text is kept."""

    __tablename__ = "access_keys"

    prefix: Mapped[str] = mapped_column(String(16), primary_key=True)
    """The beginning of the key's text, which names it in lists and logs and is no secret."""
    digest: Mapped[str] = mapped_column(String(64), unique=True)
    """Hex SHA-256 of the whole text. No slow hash is needed: the text has 256 random bits."""
    name: Mapped[str] = mapped_column(String(100))
    owner: Mapped[str] = mapped_column(String(100))
    scopes: Mapped[list[Any]]
    created_at: Mapped[datetime]
    last_used_at: Mapped[datetime | None]
    """The time of a use, to the minute."""
    revoked_at: Mapped[datetime | None]
    expires_at: Mapped[datetime | None]


class DashboardSession(Base):
    """A browser that was given a key. Only the hash of its cookie's text is kept."""

    __tablename__ = "dashboard_sessions"

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(16), ForeignKey("access_keys.prefix", ondelete="CASCADE"))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime]


class OwnedAsset(Base):
    """An upload of an owner. The same file of two owners has two rows."""

    __tablename__ = "owned_assets"

    owner: Mapped[str] = mapped_column(String(100), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    """The name by which scenes call the mesh."""
    size: Mapped[int] = mapped_column(BigInteger)
    """Bytes of the file."""
    created_at: Mapped[datetime]
