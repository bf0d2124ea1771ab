"""The record of keys."""

import secrets
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from datetime import datetime, timedelta
from hashlib import sha256

from sqlalchemy import Engine, or_, select, update
from sqlalchemy.exc import SQLAlchemyError

from services.access.caller import Scope
from services.access.models import AccessKey
from services.jobs.database import Clock, Database, now

LONGEST = 100
"""A text of more characters is no key, and is not looked up."""
USE_SECONDS = 60.0
"""Time between two records of a key's use: reading is frequent, and each record is a write."""
_ANY = select(AccessKey.prefix).limit(1)


class AccessKeys:
    """Makes, lists, revokes and finds keys."""

    def __init__(
        self,
        engine: Engine,
        clock: Clock | None = None,
        elapsed: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = Database(engine, clock)
        self._elapsed = elapsed
        self._recorded: dict[str, float] = {}

    def create(
        self, name: str, owner: str, scopes: Collection[Scope], seconds: float | None = None
    ) -> tuple[AccessKey, str]:
        """Makes a key, which expires after `seconds` if they are given. Returns it and its text, which is not kept."""
        prefix = f"sa_{secrets.token_hex(5)}"
        text = f"{prefix}_{secrets.token_urlsafe(32)}"
        with self._database.write() as session:
            at = now(session)
            key = AccessKey(
                prefix=prefix,
                digest=_digest(text),
                name=name,
                owner=owner,
                scopes=sorted(scope.value for scope in scopes),
                created_at=at,
                expires_at=None if seconds is None else at + timedelta(seconds=seconds),
            )
            session.add(key)
            return key, text

    def all(self) -> list[AccessKey]:
        """Every key ever made, oldest first."""
        with self._database.read() as session:
            return list(session.scalars(select(AccessKey).order_by(AccessKey.created_at, AccessKey.prefix)))

    def exist(self) -> bool:
        """Whether a key was ever made. One that is revoked counts, so that revoking the last one opens nothing."""
        with self._database.read() as session:
            # By the connection, which makes no object of it: every request to a service without keys asks this.
            return session.connection().scalar(_ANY) is not None

    def revoke(self, prefix: str) -> AccessKey | None:
        """Ends a key for good and returns it, or None if there is none of this prefix. Repeating it changes nothing."""
        with self._database.write() as session:
            key = session.get(AccessKey, prefix)
            if key is not None and key.revoked_at is None:
                key.revoked_at = now(session)
            return key

    def find(self, text: str) -> AccessKey | None:
        """The key with this text; None if it is unknown, revoked or expired."""
        if len(text) > LONGEST:
            return None
        with self._database.read() as session:
            key = session.scalars(select(AccessKey).where(AccessKey.digest == _digest(text))).one_or_none()
            at = now(session)
        return key if key is not None and _is_valid(key, at) else None

    def of_prefix(self, prefix: str) -> AccessKey | None:
        """The key of a session, by its prefix; None if it is revoked or expired."""
        with self._database.read() as session:
            key, at = session.get(AccessKey, prefix), now(session)
        return key if key is not None and _is_valid(key, at) else None

    def use_is_due(self, prefix: str) -> bool:
        """Whether the use of a key should be recorded: this process has not done so within `USE_SECONDS`."""
        return self._elapsed() - self._recorded.get(prefix, float("-inf")) >= USE_SECONDS

    def record_use(self, prefix: str) -> None:
        """Records that a key is used now. A failure is no error: a disk that is full refuses no reader."""
        self._recorded[prefix] = self._elapsed()
        with suppress(SQLAlchemyError), self._database.write() as session:
            change = update(AccessKey).where(AccessKey.prefix == prefix)
            session.execute(change.values(last_used_at=now(session)))

    def ended(self, prefixes: Collection[str]) -> set[str]:
        """Those of some keys, by their prefixes, that are revoked, expired or unknown. The prefix "" is that of callers
        without a key, and ends with the first key.
        """
        with self._database.read() as session:
            in_time = or_(AccessKey.expires_at.is_(None), AccessKey.expires_at > now(session))
            valid = select(AccessKey.prefix).where(
                AccessKey.prefix.in_(prefixes), AccessKey.revoked_at.is_(None), in_time
            )
            ended = set(prefixes) - set(session.scalars(valid))
        if "" in ended and not self.exist():
            ended.remove("")
        return ended


def _is_valid(key: AccessKey, at: datetime) -> bool:
    return key.revoked_at is None and (key.expires_at is None or key.expires_at > at)


def _digest(text: str) -> str:
    return sha256(text.encode("utf-8", "replace")).hexdigest()
