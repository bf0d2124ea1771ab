import pytest
from httpx import Client

from api.state import Services
from tests.unit.api.conftest import SPHERE

URL = "https://receiver.example/hook"


def test_a_webhook_shows_its_secret_once(client: Client) -> None:
    made = client.post("/v1/webhooks", json={"url": URL})
    assert made.status_code == 201, made.text
    hook = made.json()
    assert hook["secret"].startswith("whsec_")
    listed = client.get("/v1/webhooks")
    assert {"id": hook["id"], "url": URL, "created": hook["created"]} in listed.json()["items"]
    assert "whsec_" not in listed.text
    assert client.get(f"/v1/webhooks/{hook['id']}/deliveries").json() == {"items": []}
    assert client.delete(f"/v1/webhooks/{hook['id']}").status_code == 204
    assert client.delete(f"/v1/webhooks/{hook['id']}").status_code == 404
    assert client.get(f"/v1/webhooks/{hook['id']}/deliveries").status_code == 404


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({}, "url"),
        ({"url": 5}, "url"),
        ({"url": "http://receiver.example/"}, "url"),
        ({"url": "https://127.0.0.1/"}, "url"),
        ({"url": URL, "secret": "mine"}, "secret"),
    ],
)
def test_a_bad_webhook_names_its_field(client: Client, body: dict[str, object], field: str) -> None:
    answer = client.post("/v1/webhooks", json=body)
    assert answer.status_code == 422
    assert [error["field"] for error in answer.json()["errors"]] == [field]


def test_a_misspelt_field_is_answered_by_those_that_there_are(client: Client) -> None:
    """Those of the request itself, and not those of a job."""
    for path, there in (
        ("/v1/webhooks", "url"),
        ("/v1/rerenderings", "image, scene"),
        ("/v1/campaigns", "name, grids"),
    ):
        answer = client.post(path, json={"uri": URL}).json()
        [detail] = [error["detail"] for error in answer["errors"] if error["field"] == "uri"]
        assert detail.startswith(f"there is no such field; there are {there}"), detail


def test_a_message_waits_in_the_outbox(client: Client, services: Services) -> None:
    hook = client.post("/v1/webhooks", json={"url": URL}).json()
    job = client.post("/v1/jobs", json=SPHERE).json()
    client.post(f"/v1/jobs/{job['id']}/cancel")
    [told] = client.get(f"/v1/webhooks/{hook['id']}/deliveries").json()["items"]
    assert told["id"].startswith("msg_")
    assert (told["attempts"], told["delivered"], told["error"]) == (0, None, None)
    assert services.webhooks.remove(hook["id"], None)
