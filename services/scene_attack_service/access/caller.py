"""The caller of a request: an owner, what it may do, its uploads, and its quotas.

A mesh is stored once, under its hash, whoever sent it. The record comes first and the file second, both when it is
uploaded and when it is deleted: files are removed only while nobody has the mesh.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import TypeVar

from sqlalchemy import BigInteger, Engine, String, delete, func, select, update
from sqlalchemy.orm import Mapped, mapped_column

from scene_attack.errors import QuotaExceeded
from scene_attack_service.jobs.database import Clock, Database, now
from scene_attack_service.jobs.models import Asset, Base, Campaign, Job
from scene_attack_service.jobs.uploads import check_unused, hold

Owned = TypeVar("Owned", Job, Campaign)


class Scope(StrEnum):
    """Permission of a key. `admin` allows everything, and to see what every owner has."""

    JOBS_READ = "jobs:read"
    JOBS_WRITE = "jobs:write"
    ASSETS_WRITE = "assets:write"
    METRICS_READ = "metrics:read"
    ADMIN = "admin"


@dataclass(frozen=True)
class Caller:
    """Sender of a request: the owner of what it makes, its scopes, and the prefix of its key, "" for no key."""

    owner: str
    scopes: frozenset[Scope]
    key: str

    @classmethod
    def of(cls, owner: str, scopes: Iterable[str], key: str) -> "Caller":
        """The caller with these scopes; words that are no scope, of another version, allow nothing."""
        return cls(owner, frozenset(scope for scope in Scope if scope in set(scopes)), key)

    def may(self, scope: Scope) -> bool:
        """Whether the caller's scopes allow what needs `scope`."""
        return scope in self.scopes or Scope.ADMIN in self.scopes

    @property
    def only(self) -> str | None:
        """The owner whose jobs, campaigns and uploads the caller sees; None sees those of all."""
        return None if self.may(Scope.ADMIN) else self.owner

    def visible(self, owned: Owned | None) -> Owned | None:
        """Returns `owned` if the caller sees its owner's, else None: what others have does not exist for the caller."""
        return owned if owned is not None and self.only in (None, owned.owner) else None


KEYLESS = Caller("", frozenset(Scope), "")
"""Any program of this machine while there is no key: it may do everything, and what it makes belongs to ""."""


class OwnedAsset(Base):
    """An upload of an owner. The same file of two owners has two rows."""

    __tablename__ = "owned_assets"

    owner: Mapped[str] = mapped_column(String(100), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    """The name by which scenes call the mesh."""
    size: Mapped[int] = mapped_column(BigInteger)
    """Bytes of the file."""
    created_at: Mapped[datetime]


class OwnedAssets:
    """Adds, finds and deletes the uploads of owners."""

    def __init__(self, engine: Engine, clock: Clock | None = None) -> None:
        self._database = Database(engine, clock)

    def add(self, owner: str, name: str, size: int, title: str | None = None) -> bool:
        """Records that an owner uploads the mesh of this name, of `size` bytes. Returns False if it had done so."""
        with self._database.write() as session:
            if hold(session, [name], to_change=True):
                session.execute(update(Asset).where(Asset.name == name).values(deleted_at=None))
            if title is not None:
                session.execute(update(Asset).where(Asset.name == name).values(title=title))
            if session.get(OwnedAsset, (owner, name)) is not None:
                return False
            session.add(OwnedAsset(owner=owner, name=name, size=size, created_at=now(session)))
            return True

    @contextmanager
    def adding(self, owner: str, name: str, size: int, title: str | None = None) -> Iterator[None]:
        """Records an upload for the time in which its file is read and stored, and for good unless that fails."""
        is_new = self.add(owner, name, size, title)
        try:
            yield
        except BaseException:
            if is_new:
                with self._database.write() as session:
                    session.execute(delete(OwnedAsset).where(OwnedAsset.owner == owner, OwnedAsset.name == name))
            raise

    def delete(self, caller: Caller, name: str) -> bool:
        """Deletes the caller's upload, or that of all owners if it is an administrator. Returns False if there is none.

        Raises InUse if a job or campaign of the owner refers to the mesh; of others, only if no owner is left.
        """
        owner = caller.only
        with self._database.write() as session:
            if owner is not None and session.get(OwnedAsset, (owner, name)) is None:
                return False
            if hold(session, [name], to_change=True):
                return False
            owners = session.scalars(select(OwnedAsset.owner).where(OwnedAsset.name == name)).all()
            if owner is not None and owner not in owners:  # it was deleted before this transaction held it
                return False
            is_last = owner is None or list(owners) == [owner]
            check_unused(session, name, owner, by_others=is_last)
            gone = (OwnedAsset.name == name,) if owner is None else (OwnedAsset.name == name, OwnedAsset.owner == owner)
            session.execute(delete(OwnedAsset).where(*gone))
            if is_last:
                session.execute(update(Asset).where(Asset.name == name).values(deleted_at=now(session)))
            return True

    def used(self, owner: str) -> int:
        """The bytes that an owner has uploaded."""
        with self._database.read() as session:
            return session.scalar(select(func.sum(OwnedAsset.size)).where(OwnedAsset.owner == owner)) or 0

    def visible(self, caller: Caller) -> Callable[[str], bool]:
        """The function that says whether the caller sees the upload of a name: its owner has uploaded it, too.
        Administrators see all that were not deleted.
        """
        only = caller.only
        with self._database.read() as session:
            if only is None:
                deleted = frozenset(session.scalars(select(Asset.name).where(Asset.deleted_at.is_not(None))))
                return lambda name: name not in deleted
            names = frozenset(session.scalars(select(OwnedAsset.name).where(OwnedAsset.owner == only)))
        return names.__contains__


UPLOAD_SECONDS = 3600.0
"""Time after which an upload over the quota may be tried again: somebody has to delete something first."""


@dataclass(frozen=True)
class Quotas:
    """Limits that the settings set for each owner: queued jobs, campaigns that have not ended, uploaded bytes.

    The owner "", of a service without keys, has no quotas.
    """

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
