"""Routes for webhooks: who is told when jobs and campaigns end."""

from datetime import datetime
from typing import Annotated, Self

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict, Field

from api.authentication import CallerDependency
from api.bodies import body_of
from api.routes.jobs import json_body
from api.state import ServicesDependency, no_such
from services.jobs.webhook_models import Delivery, Webhook
from services.jobs.webhook_sending import LONGEST_URL, check_url
from services.strict import Strict

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])


class WebhookRequest(Strict):
    """Whom to tell."""

    model_config = ConfigDict(extra="forbid")

    url: str = Field(max_length=LONGEST_URL, description="an https URL, which gets a POST for each event")


class WebhookView(BaseModel):
    """A webhook."""

    id: str
    url: str
    created: datetime

    @classmethod
    def of(cls, webhook: Webhook) -> Self:
        """The view of a webhook in the database."""
        return cls(id=webhook.id, url=webhook.url, created=webhook.created_at)


class NewWebhook(WebhookView):
    """A webhook with its secret, which is shown once."""

    secret: str = Field(description='"whsec_" and the base64 of the key of the signatures')


class WebhookList(BaseModel):
    """Webhooks, oldest first."""

    items: list[WebhookView]


class DeliveryView(BaseModel):
    """A message to a webhook."""

    id: str = Field(description="the message's `webhook-id`, the same in every attempt")
    created: datetime
    attempts: int
    delivered: datetime | None
    next: datetime | None = Field(description="time of the next attempt; null if there will be none")
    status: int | None = Field(description="HTTP status of the last answer")
    error: str | None = Field(description="why the last attempt did not succeed")

    @classmethod
    def of(cls, one: Delivery) -> Self:
        """The view of a message in the database."""
        return cls(
            id=one.id,
            created=one.created_at,
            attempts=one.attempts,
            delivered=one.delivered_at,
            next=one.due_at,
            status=one.status,
            error=one.error,
        )


class DeliveryList(BaseModel):
    """The last messages to a webhook, newest first."""

    items: list[DeliveryView]


@router.post("", status_code=201, dependencies=[Depends(json_body)])
def create_webhook(
    asked: Annotated[WebhookRequest, Depends(body_of(WebhookRequest))],
    services: ServicesDependency,
    caller: CallerDependency,
) -> NewWebhook:
    """Registers a URL that is told when a job or campaign of the caller ends, as Standard Webhooks describes.

    The message is {"type", "timestamp", "data"}, with a type such as "job.succeeded" or "campaign.finished". A receiver
    checks `webhook-signature` with the secret, and answers with a status from 200 to 299; otherwise the message is sent
    again, nine times within about 14 hours.
    """
    check_url(asked.url, services.webhook_hosts)
    made = services.webhooks.create(caller.owner, asked.url)
    return NewWebhook(id=made.id, url=made.url, created=made.created_at, secret=made.secret)


@router.get("")
def list_webhooks(services: ServicesDependency, caller: CallerDependency) -> WebhookList:
    """Lists the webhooks, without their secrets."""
    return WebhookList(items=[WebhookView.of(one) for one in services.webhooks.all(caller.only)])


@router.get("/{webhook_id}/deliveries")
def list_deliveries(webhook_id: str, services: ServicesDependency, caller: CallerDependency) -> DeliveryList:
    """Lists the last hundred messages to a webhook; those that have ended are kept for a week."""
    if webhook_id not in {one.id for one in services.webhooks.all(caller.only)}:
        raise no_such("webhook")
    return DeliveryList(items=[DeliveryView.of(one) for one in services.webhooks.deliveries(webhook_id)])


@router.delete("/{webhook_id}", status_code=204, response_class=Response)
def delete_webhook(webhook_id: str, services: ServicesDependency, caller: CallerDependency) -> None:
    """Deletes a webhook, with the messages that were still to be sent."""
    if not services.webhooks.remove(webhook_id, caller.only):
        raise no_such("webhook")
