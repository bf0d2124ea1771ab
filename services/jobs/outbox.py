"""Puts messages for webhooks into the outbox, in the transaction of the change that they tell of."""

import json
from datetime import UTC, datetime
from typing import Any
from uuid import uuid4

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.jobs.models import Campaign, Job
from services.jobs.webhook_models import Delivery, Webhook


def tell_of_job(session: Session, job: Job, data: dict[str, Any], now: datetime) -> None:
    """Tells that a job has ended; `data` is that of its last event."""
    _tell(session, job.owner, f"job.{job.state.value}", {"id": job.id, "name": job.name, **data}, now)


def tell_of_campaign(session: Session, campaign_id: str, now: datetime) -> None:
    """Tells that a campaign has ended."""
    columns = select(Campaign.owner, Campaign.name, Campaign.state, Campaign.failure)
    owner, name, state, failure = session.execute(columns.where(Campaign.id == campaign_id)).one()
    data = {"id": campaign_id, "name": name, "state": state.value, "failure": failure}
    _tell(session, owner, f"campaign.{state.value}", data, now)


def _tell(session: Session, owner: str, kind: str, data: dict[str, Any], now: datetime) -> None:
    # locked, so that none is deleted before its message is written
    found = select(Webhook.id).where(Webhook.owner == owner).order_by(Webhook.id)
    for webhook in session.scalars(found.with_for_update(read=True, key_share=True)).all():
        message = {"type": kind, "timestamp": now.astimezone(UTC).isoformat(), "data": data}
        body = json.dumps(message, ensure_ascii=False, allow_nan=False)
        made = Delivery(id=f"msg_{uuid4().hex}", webhook_id=webhook, body=body, created_at=now, due_at=now, attempts=0)
        session.add(made)
