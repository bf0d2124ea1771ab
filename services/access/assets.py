"""The record of who uploaded which mesh. The file itself is stored once, under its hash, whoever sent it."""

from collections.abc import Callable

from sqlalchemy import func, select

from services.access.caller import Caller
from services.access.models import OwnedAsset
from services.jobs.transactions import Transactions


class OwnedAssets(Transactions):
    """Adds and finds the uploads of owners."""

    def add(self, owner: str, name: str, size: int) -> None:
        """Records that an owner uploaded the mesh of this name, of `size` bytes. Repeating it changes nothing."""
        with self._write() as session:
            if session.get(OwnedAsset, (owner, name)) is None:
                session.add(OwnedAsset(owner=owner, name=name, size=size, created_at=self._now(session)))

    def used(self, owner: str) -> int:
        """The bytes that an owner has uploaded."""
        with self._read() as session:
            return session.scalar(select(func.sum(OwnedAsset.size)).where(OwnedAsset.owner == owner)) or 0

    def visible(self, caller: Caller) -> Callable[[str], bool]:
        """The function that says whether the caller sees the upload of a name: its owner has uploaded it, too."""
        only = caller.only
        if only is None:
            return lambda _: True
        with self._read() as session:
            names = frozenset(session.scalars(select(OwnedAsset.name).where(OwnedAsset.owner == only)))
        return names.__contains__
