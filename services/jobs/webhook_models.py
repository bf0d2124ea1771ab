"""The tables of webhooks: who is told, and the outbox of what is still to be told."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from services.jobs.models import Base


class Webhook(Base):
    """An address that is told when a job or campaign of its owner ends."""

    __tablename__ = "webhooks"
    __table_args__ = (Index("webhooks_by_owner", "owner", "created_at"),)

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    owner: Mapped[str] = mapped_column(String(100))
    url: Mapped[str] = mapped_column(String(2000))
    secret: Mapped[str] = mapped_column(String(100))
    """The key of its signatures, as text: "whsec_" and base64."""
    created_at: Mapped[datetime]


class Delivery(Base):
    """A message to a webhook, until it has been delivered or given up, and a while longer."""

    __tablename__ = "deliveries"
    __table_args__ = (Index("deliveries_by_time", "due_at"), Index("deliveries_by_webhook", "webhook_id", "created_at"))

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    webhook_id: Mapped[str] = mapped_column(ForeignKey("webhooks.id", ondelete="CASCADE"))
    body: Mapped[str] = mapped_column(Text)
    """The message's bytes as JSON text: every attempt sends and signs the same."""
    created_at: Mapped[datetime]
    due_at: Mapped[datetime | None]
    """The time of the next attempt; None once there will be none."""
    attempts: Mapped[int] = mapped_column(default=0)
    delivered_at: Mapped[datetime | None]
    status: Mapped[int | None]
    """HTTP status of the last answer."""
    error: Mapped[str | None] = mapped_column(String(300))
    """Why the last attempt did not succeed."""
