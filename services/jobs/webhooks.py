"""The record of webhooks, and their outbox: which messages are due, and how each attempt at one ended."""

import secrets
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from hashlib import sha256
from types import MappingProxyType
from typing import Any
from uuid import uuid4

from sqlalchemy import case, delete, func, select, update

from services.errors import InvalidRequest
from services.jobs.transactions import Transactions
from services.jobs.webhook_models import Delivery, Webhook

MOST = 20
"""Webhooks of an owner."""
ATTEMPTS = 10
"""Attempts at a message; the last is about 14 hours after the first."""
FIRST_SECONDS = 5.0
"""Wait after the first attempt; it triples each time."""
NOBODY: Mapping[str, int] = MappingProxyType({})
"""The messages on their way, if there are none."""
KEPT = timedelta(days=7)
"""Time for which messages are kept that were delivered or given up."""


@dataclass(frozen=True)
class Message:
    """A message to send now: its id, the bytes of its body, where to, the secret of its signature, and whose it is."""

    id: str
    body: bytes
    url: str
    secret: str
    attempt: int
    owner: str = ""


class Webhooks(Transactions):
    """Webhooks and their messages."""

    def create(self, owner: str, url: str) -> Webhook:
        """Records a webhook with a new secret. Raises InvalidRequest("url") if the owner has too many."""
        with self._write() as session:
            if (session.scalar(select(func.count()).select_from(Webhook).where(Webhook.owner == owner)) or 0) >= MOST:
                raise InvalidRequest("url", f"there are {MOST} webhooks already, which is the most; delete one first")
            secret = f"whsec_{b64encode(secrets.token_bytes(32)).decode()}"
            made = Webhook(id=uuid4().hex, owner=owner, url=url, secret=secret, created_at=self._now(session))
            session.add(made)
            return made

    def all(self, owner: str | None) -> list[Webhook]:
        """The webhooks of an owner, or of all, oldest first."""
        query = select(Webhook).order_by(Webhook.created_at, Webhook.id)
        with self._read() as session:
            return list(session.scalars(query if owner is None else query.where(Webhook.owner == owner)))

    def remove(self, webhook_id: str, owner: str | None) -> bool:
        """Deletes a webhook of an owner, or of any, with its messages. Returns whether there was one."""
        own = [Webhook.id == webhook_id] if owner is None else [Webhook.id == webhook_id, Webhook.owner == owner]
        with self._write() as session:
            return session.scalar(delete(Webhook).where(*own).returning(Webhook.id)) is not None

    def deliveries(self, webhook_id: str, limit: int = 100) -> list[Delivery]:
        """The last messages to a webhook, newest first."""
        query = select(Delivery).where(Delivery.webhook_id == webhook_id)
        with self._read() as session:
            return list(session.scalars(query.order_by(Delivery.created_at.desc(), Delivery.id).limit(limit)))

    def take(self, limit: int, seconds: float, most: int = 1, busy: Mapping[str, int] = NOBODY) -> list[Message]:
        """Takes at most `limit` messages that are due. Unless `ended` says otherwise, they are due again in `seconds`:
        a process that dies loses none.

        Owners take turns, each with its oldest message first. An owner gets `most` messages at once, less those that
        `busy` says are on their way: receivers that do not answer delay the messages of their owner only.
        """
        with self._read() as session:  # most of the time there is none, and nothing is written
            now = self._now(session)
            turn = func.row_number().over(partition_by=Webhook.owner, order_by=(Delivery.due_at, Delivery.id))
            due = select(Delivery.id, Delivery.due_at, Webhook.owner, turn.label("turn"))
            first = due.join(Webhook).where(Delivery.due_at <= now).subquery()
            left = most - case(dict(busy), value=first.c.owner, else_=0) if busy else most
            mine = select(first.c.id).where(first.c.turn <= left).order_by(first.c.turn, first.c.due_at)
            ids = session.scalars(mine.limit(limit)).all()
            if not ids:
                return []
        with self._write() as session:
            now = self._now(session)
            still = select(Delivery.id).where(Delivery.id.in_(ids), Delivery.due_at <= now)
            taken = session.scalars(still.with_for_update(skip_locked=True)).all()
            session.execute(
                update(Delivery)
                .where(Delivery.id.in_(taken))
                .values(due_at=now + timedelta(seconds=seconds), attempts=Delivery.attempts + 1)
                .execution_options(synchronize_session=False)
            )
            found = session.execute(
                select(Delivery.id, Delivery.body, Webhook.url, Webhook.secret, Delivery.attempts, Webhook.owner)
                .join(Webhook)
                .where(Delivery.id.in_(taken))
            )
            return [
                Message(one.id, one.body.encode(), one.url, one.secret, one.attempts, one.owner)
                for one in sorted(found, key=lambda one: ids.index(one.id))
            ]

    def ended(self, message: Message, status: int | None, error: str | None) -> None:
        """Records an attempt: delivered if there was no error, else due again, or given up after the last attempt."""
        with self._write() as session:
            now = self._now(session)
            values: dict[str, Any] = {"status": status, "error": None if error is None else error[:300], "due_at": None}
            if error is None:
                values["delivered_at"] = now
            elif message.attempt < ATTEMPTS:
                values["due_at"] = now + timedelta(seconds=wait(message.id, message.attempt))
            mine = (Delivery.id == message.id, Delivery.attempts == message.attempt)
            session.execute(update(Delivery).where(*mine).values(values))

    def sweep(self) -> None:
        """Deletes messages that were delivered or given up some time ago."""
        with self._write() as session:
            old = (Delivery.due_at.is_(None), Delivery.created_at < self._now(session) - KEPT)
            session.execute(delete(Delivery).where(*old))


def wait(message_id: str, attempt: int) -> float:
    """Seconds to wait after an attempt: exponential, and spread by a quarter to both sides by the message's id, so that
    messages that failed together are not sent together again.
    """
    share = int.from_bytes(sha256(f"{message_id} {attempt}".encode()).digest()[:8]) / 2**64
    return FIRST_SECONDS * 3.0 ** (attempt - 1) * (0.75 + share / 2)
