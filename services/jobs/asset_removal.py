"""Removes the files of uploaded meshes that were deleted."""

from datetime import timedelta

from sqlalchemy import delete, select

from services.jobs.asset_models import Asset
from services.jobs.asset_uses import hold
from services.jobs.database import Database, now
from services.scenes.library import Library

REQUEST_SECONDS = 3600.0
"""Time for which it is remembered that a mesh was deleted: a request may have seen it before, and still be checked."""


class DeletedAssets:
    """The uploads that were deleted, and their files in a library."""

    def __init__(self, database: Database, library: Library) -> None:
        self._database = database
        self._library = library

    def remove(self, name: str) -> None:
        """Removes the files of an upload unless it is there again. Raises OSError; `remove_all` then does it later."""
        self._library.has_upload(name)  # raises OSError while the store is away, before anything waits for this
        with self._database.write() as session:  # until the files have gone, nobody can upload the mesh again
            if name in hold(session, [name], to_change=True):
                self._library.remove_upload(name)

    def remove_all(self) -> None:
        """Removes the files of all uploads that were deleted, and forgets those of long ago. Raises OSError."""
        with self._database.read() as session:
            before = now(session) - timedelta(seconds=REQUEST_SECONDS)
            names = session.scalars(select(Asset.name).where(Asset.deleted_at.is_not(None))).all()
        for name in names:
            self.remove(name)
        with self._database.write() as session:
            session.execute(delete(Asset).where(Asset.deleted_at < before))
