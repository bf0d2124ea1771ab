"""The tables of uploaded meshes: those that were deleted, and which jobs and campaigns refer to which."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from services.jobs.models import Base


class Asset(Base):
    """An uploaded mesh. Its row is what transactions hold that refer to the mesh, upload it or delete it."""

    __tablename__ = "assets"
    __table_args__ = (Index("assets_by_deletion", "deleted_at"),)

    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    """The name by which scenes call the mesh."""
    title: Mapped[str | None] = mapped_column(String(100))
    """The name that people see, if its uploader gave one."""
    deleted_at: Mapped[datetime | None]
    """The time at which it was deleted; None while it is there. The row stays for as long as a request may take."""


class JobAsset(Base):
    """A job refers to an uploaded mesh."""

    __tablename__ = "job_assets"
    __table_args__ = (Index("job_assets_by_name", "name"),)

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)


class CampaignAsset(Base):
    """A campaign refers to an uploaded mesh."""

    __tablename__ = "campaign_assets"
    __table_args__ = (Index("campaign_assets_by_name", "name"),)

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
