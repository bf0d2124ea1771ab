import json
import re
from pathlib import Path

import pytest
import yaml
from fastapi.routing import APIRoute, iter_route_contexts
from httpx import Client
from pydantic import TypeAdapter

from scene_attack_api.main import create_app
from scene_attack_api.openapi import document
from scene_attack_api.problems import ProblemDetails
from scene_attack_service.settings import Settings

pytestmark = pytest.mark.slow

COMMITTED = Path(__file__).parents[3] / "openapi.yaml"


@pytest.mark.questions
def test_the_committed_description_is_what_the_code_says() -> None:
    assert COMMITTED.read_text() == document(), "run: python -m scene_attack_api.openapi > openapi.yaml"


@pytest.mark.questions
def test_it_is_what_the_app_serves(client: Client) -> None:
    assert yaml.safe_load(COMMITTED.read_text()) == client.get("/openapi.json").json()


def test_every_field_of_a_request_is_described() -> None:
    schemas = yaml.safe_load(COMMITTED.read_text())["components"]["schemas"]
    assert schemas["Camera"]["properties"]["distance"]["description"]
    assert schemas["Camera"]["properties"]["distance"]["maximum"] == 100
    assert {"JobSpec", "JobView", "Result", "ProblemDetails", "FGSM", "ZOO"} <= set(schemas)


def test_errors_are_described_as_problems() -> None:
    operations = yaml.safe_load(COMMITTED.read_text())["paths"]["/v1/jobs"]["post"]["responses"]
    for status in ("413", "415", "422", "503"):
        assert list(operations[status]["content"]) == ["application/problem+json"]
    assert set(operations["400"]["content"]) == {"application/problem+json", "text/plain"}  # the parser's own


def test_operations_and_schemas_have_names_that_a_person_gave() -> None:
    described = yaml.safe_load(COMMITTED.read_text())
    operations = [one for methods in described["paths"].values() for one in methods.values()]
    names = [one["operationId"] for one in operations]
    assert len(set(names)) == len(names)
    for name in names:
        # The framework's own names end in the path and the method.
        assert re.fullmatch(r"[a-z]+(_[a-z]+)+", name), name
        assert not re.search(r"_v1_|_(get|post|patch|delete|head)$", name), name
    assert {tag for one in operations for tag in one["tags"]} == {tag["name"] for tag in described["tags"]}
    assert all(re.fullmatch("[A-Za-z]+", name) for name in described["components"]["schemas"])
    bodies = [kind["schema"] for one in operations for kind in one.get("requestBody", {}).get("content", {}).values()]
    assert all(list(schema) == ["$ref"] for schema in bodies)


EXAMPLES = json.loads((COMMITTED.parent / "api" / "scene_attack_api" / "examples.json").read_text())
ROUTES = {
    route.name: route
    for route in (context.original_route for context in iter_route_contexts(create_app(Settings()).router.routes))
    if isinstance(route, APIRoute) and route.include_in_schema
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_of_an_answer_is_what_its_model_says(name: str) -> None:
    model = TypeAdapter(ROUTES[name].response_model)
    example = EXAMPLES[name]["answer"]
    assert model.dump_python(model.validate_python(example), mode="json") == example


def test_bodies_and_errors_have_examples() -> None:
    described = yaml.safe_load(COMMITTED.read_text())
    (misspelt,) = described["components"]["schemas"]["ProblemDetails"]["examples"]
    assert ProblemDetails.model_validate(misspelt).model_dump() == misspelt
    for methods in described["paths"].values():
        for operation in methods.values():
            content = operation.get("requestBody", {}).get("content", {})
            if "application/json" in content:
                assert content["application/json"]["example"] == EXAMPLES[operation["operationId"]]["request"]
