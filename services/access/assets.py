"""The record of who uploaded which mesh. The file itself is stored once, under its hash, whoever sent it.

The record comes first and the files second, both when a mesh is uploaded and when it is deleted: files are removed only
while nobody has the mesh.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sqlalchemy import Engine, delete, func, select, update

from services.access.caller import Caller
from services.access.models import OwnedAsset
from services.jobs.database import Clock, Database, now
from services.jobs.models import Asset
from services.jobs.uploads import check_unused, hold


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
