"""The page `/docs`: the API's own description in words. It loads nothing from other sites and runs no script."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Request, Response

from scene_attack_api.dashboard.pages import html
from scene_attack_api.requests import CallerDependency

REF = "#/components/schemas/"
router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class Value:
    """A parameter, field, body or answer: name, type as parts of (text, name of a schema or None), and words."""

    name: str
    type: list[tuple[str, str | None]]
    words: str
    required: bool


@dataclass(frozen=True)
class Operation:
    """A method of a path."""

    method: str
    path: str
    words: str
    scope: str | None
    parameters: list[Value]
    body: Value | None
    answers: list[Value]


@router.get("/docs")
def reference(request: Request, caller: CallerDependency) -> Response:
    """The page."""
    described = request.app.openapi()
    operations = [
        _operation(method, path, operation)
        for path, methods in described["paths"].items()
        for method, operation in methods.items()
    ]
    schemas = {name: _fields(schema) for name, schema in sorted(described["components"]["schemas"].items())}
    words = {name: schema.get("description", "") for name, schema in described["components"]["schemas"].items()}
    kinds = {name: type_of(schema) for name, schema in described["components"]["schemas"].items() if not schemas[name]}
    values: dict[str, Any] = {"operations": operations, "schemas": schemas, "described": words, "kinds": kinds}
    return html("reference.html", caller=caller, intro=described["info"]["description"], **values)


def _operation(method: str, path: str, operation: Mapping[str, Any]) -> Operation:
    body = operation.get("requestBody", {}).get("content", {})
    media = next(iter(body), None)
    security = operation.get("security") or [{}]
    return Operation(
        method=method.upper(),
        path=path,
        words=operation.get("description", ""),
        scope=next(iter(security[0].get("key", [])), None),
        parameters=[
            Value(f"{p['name']} ({p['in']})", type_of(p["schema"]), p.get("description", ""), p.get("required", False))
            for p in operation.get("parameters", [])
        ],
        body=None if media is None else Value(media, type_of(body[media]["schema"]), "", True),
        answers=[
            Value(status, _answer(response.get("content", {})), response.get("description", ""), True)
            for status, response in sorted(operation["responses"].items())
        ],
    )


def _answer(content: Mapping[str, Any]) -> list[tuple[str, str | None]]:
    parts: list[tuple[str, str | None]] = []
    for media, described in content.items():
        parts += [
            (", " if parts else "", None),
            *(type_of(described["schema"]) if described.get("schema") else [(media, None)]),
        ]
    return parts


def _fields(schema: Mapping[str, Any]) -> list[Value]:
    required = schema.get("required", [])
    return [
        Value(name, type_of(field), field.get("description", ""), name in required)
        for name, field in schema.get("properties", {}).items()
    ]


def type_of(schema: Mapping[str, Any]) -> list[tuple[str, str | None]]:
    """The type of a JSON schema in words, e.g. [("list of ", None), ("Light", "Light"), (" or null", None)]."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix(REF)
        return [(name, name)]
    for how in ("anyOf", "oneOf", "allOf"):
        if how in schema:
            parts: list[tuple[str, str | None]] = []
            for option in schema[how]:
                parts += [*([(" or ", None)] if parts else []), *type_of(option)]
            return parts
    if "const" in schema:
        return [(f"“{schema['const']}”", None)]
    if "enum" in schema:
        return [(" or ".join(f"“{value}”" for value in schema["enum"]), None)]
    kind = schema.get("type", "anything")
    if kind == "array":
        return [("list of ", None), *type_of(schema.get("items", {}))]
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return [("object of ", None), *type_of(schema["additionalProperties"])]
    return [(f"{kind}{_limits(schema)}", None)]


def _limits(schema: Mapping[str, Any]) -> str:
    words = {
        "minimum": "at least {}",
        "exclusiveMinimum": "above {}",
        "maximum": "at most {}",
        "exclusiveMaximum": "below {}",
        "maxLength": "at most {} characters",
    }
    texts = [text.format(schema[name]) for name, text in words.items() if name in schema]
    return f", {', '.join(texts)}" if texts else ""
