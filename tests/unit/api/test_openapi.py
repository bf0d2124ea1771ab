from pathlib import Path

import yaml
from httpx import Client

from api.openapi import document

COMMITTED = Path(__file__).parents[3] / "openapi.yaml"


def test_the_committed_description_is_what_the_code_says() -> None:
    assert COMMITTED.read_text() == document(), "run: python -m api.openapi > openapi.yaml"


def test_it_is_what_the_app_serves(client: Client) -> None:
    assert yaml.safe_load(COMMITTED.read_text()) == client.get("/openapi.json").json()


def test_every_field_of_a_request_is_described() -> None:
    schemas = yaml.safe_load(COMMITTED.read_text())["components"]["schemas"]
    assert schemas["Camera"]["properties"]["distance"]["description"]
    assert schemas["Camera"]["properties"]["distance"]["maximum"] == 100
    assert {"JobSpec", "JobView", "Result", "ProblemDetails", "Fgsm", "Zoo"} <= set(schemas)


def test_errors_are_described_as_problems() -> None:
    operations = yaml.safe_load(COMMITTED.read_text())["paths"]["/v1/jobs"]["post"]["responses"]
    for status in ("413", "415", "422", "503"):
        assert list(operations[status]["content"]) == ["application/problem+json"]
    assert set(operations["400"]["content"]) == {"application/problem+json", "text/plain"}  # the parser's own
