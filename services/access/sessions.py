"""Sessions of the dashboard: a browser that was given a key shows a text of its own instead, until it signs out."""

import secrets
from datetime import timedelta
from hashlib import sha256

from sqlalchemy import Engine, delete, select

from services.access.models import DashboardSession
from services.jobs.database import Clock, Database, now

SESSION_SECONDS = 12 * 60 * 60
"""Time after which a session ends by itself."""
LONGEST = 100
"""A text of more characters is no session's, and is not looked up."""


class Sessions:
    """Begins, finds and ends sessions. A session is worth what its key is: whoever finds one looks at the key, too."""

    def __init__(self, engine: Engine, clock: Clock | None = None) -> None:
        self._database = Database(engine, clock)

    def begin(self, prefix: str) -> str:
        """Begins a session of the key with this prefix. Returns its text, 256 random bits; the hash of it is kept."""
        text = secrets.token_urlsafe(32)
        with self._database.write() as session:
            at = now(session)
            session.execute(delete(DashboardSession).where(DashboardSession.expires_at <= at))
            expires = at + timedelta(seconds=SESSION_SECONDS)
            session.add(DashboardSession(digest=_digest(text), key=prefix, created_at=at, expires_at=expires))
        return text

    def key_of(self, text: str) -> str | None:
        """The prefix of the key of the session with this text; None if it is unknown or has ended."""
        if not 0 < len(text) <= LONGEST:
            return None
        with self._database.read() as session:
            found = session.scalars(select(DashboardSession).where(DashboardSession.digest == _digest(text))).first()
            return None if found is None or found.expires_at <= now(session) else found.key

    def end(self, text: str) -> None:
        """Ends the session with this text, if there is one."""
        with self._database.write() as session:
            session.execute(delete(DashboardSession).where(DashboardSession.digest == _digest(text[:LONGEST])))


def _digest(text: str) -> str:
    return sha256(text.encode("utf-8", "replace")).hexdigest()
