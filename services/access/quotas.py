"""What one owner may have: queued jobs, campaigns that have not ended, uploaded bytes.

The owner "", of a service without keys, has no quotas.
"""

from dataclasses import dataclass

from services.access.assets import OwnedAssets
from services.errors import QuotaExceeded

UPLOAD_SECONDS = 3600.0
"""Time after which an upload over the quota may be tried again: somebody has to delete something first."""


@dataclass(frozen=True)
class Quotas:
    """The quotas of the settings, each for one owner."""

    assets: OwnedAssets
    queued: int
    campaigns: int
    upload_bytes: int

    def queued_of(self, owner: str) -> int | None:
        """The largest number of jobs that the owner may have queued; None if there is no limit."""
        return self.queued if owner else None

    def campaigns_of(self, owner: str) -> int | None:
        """The largest number of campaigns that have not ended for the owner; None if there is no limit."""
        return self.campaigns if owner else None

    def check_upload(self, owner: str, size: int) -> None:
        """Raises QuotaExceeded if the owner may not upload `size` more bytes."""
        if owner and self.assets.used(owner) + size > self.upload_bytes:
            raise QuotaExceeded(f"an owner may have uploaded {self.upload_bytes:,} bytes in all", UPLOAD_SECONDS)
