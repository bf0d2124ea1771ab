"""Keys to the API, and the sessions of browsers that were given one.

Other machines reach the service only once there is a key (`check_listening`). A browser shows a text of its session
instead of the key, until it signs out.
"""

import os
import secrets
import socket
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from datetime import datetime, timedelta
from hashlib import sha256
from typing import Any

from sqlalchemy import Engine, ForeignKey, String, delete, or_, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Mapped, mapped_column

from scene_attack.addresses import is_loopback
from scene_attack.errors import InvalidRequest
from scene_attack_service.access.caller import Scope
from scene_attack_service.jobs.database import Clock, Database, connect, migrate, now
from scene_attack_service.jobs.models import Base
from scene_attack_service.settings import Settings


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


LONGEST = 100
"""A text of more characters is no key or session, and is not looked up."""
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


SESSION_SECONDS = 12 * 60 * 60
"""Time after which a session ends by itself."""


class DashboardSession(Base):
    """A browser that was given a key. Only the hash of its cookie's text is kept."""

    __tablename__ = "dashboard_sessions"

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(16), ForeignKey("access_keys.prefix", ondelete="CASCADE"))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime]


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
            row = session.scalars(select(DashboardSession).where(DashboardSession.digest == _digest(text))).first()
            return None if row is None or row.expires_at <= now(session) else row.key

    def end(self, text: str) -> None:
        """Ends the session with this text, if there is one."""
        with self._database.write() as session:
            session.execute(delete(DashboardSession).where(DashboardSession.digest == _digest(text[:LONGEST])))


def check_listening(settings: Settings) -> None:
    """Raises InvalidRequest("--host") if other machines reach the settings' address and there is no key."""
    host = settings.host
    if is_loopback(host):
        return
    engine = connect(settings)
    try:
        migrate(engine, settings)
        has_key = AccessKeys(engine).exist()
    finally:
        engine.dispose()
    if not has_key:
        raise InvalidRequest(
            "--host",
            f"at {host or 'every address'} other machines reach the service, and it has no key yet, so anybody could "
            "use it; make one with `scene-attack keys create NAME --scope admin` (in a container: `docker compose run "
            "--rm api scene-attack keys create NAME --scope admin`), or listen on 127.0.0.1",
        )


def listen(host: str, port: int) -> socket.socket:
    """Opens a listening socket; port 0 stands for any free port. Raises InvalidRequest("--port") if that cannot be."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        detail = f"cannot listen on {host}:{port} ({reason}); try --port 0"
        raise InvalidRequest("--port", detail) from error
