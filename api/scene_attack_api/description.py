"""The OpenAPI document's description of the API, its errors and its examples."""

import json
from functools import cache
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Response

from scene_attack_api.authentication import scope_of
from scene_attack_api.problems import MEDIA_TYPE, ProblemDetails

DESCRIPTION = """\
Attacks on vision models through the scene: its light, its surfaces, its poses.

A request is checked completely before it becomes a job; errors are answered at once and name the fields. Every error is
a problem document (RFC 9457). Angles are in radians, lengths in scene units, colours and images in [0,1].
"""

TAGS = [
    {"name": "jobs", "description": "Preview, submit, list, read, edit, cancel, continue and delete attacks."},
    {"name": "artifacts", "description": "The files of a job, and its export."},
    {"name": "campaigns", "description": "Many attacks on many views, with one table."},
    {"name": "assets", "description": "Meshes and environment maps: those that you upload, and the library."},
    {"name": "targets", "description": "The networks that can be attacked."},
    {"name": "defences", "description": "Defences against attacks."},
    {"name": "service", "description": "Health and metrics of the service."},
]

ERRORS = {
    "400": "The request could not be read: the body, or the head, which may have 64 KiB.",
    "401": "A key is needed, and none was sent that is known, not revoked and not expired.",
    "403": "The key's scopes do not allow this, or another web site made a browser send it.",
    "404": "The path names nothing that exists.",
    "409": "It is in use, has no result, or cannot be continued.",
    "413": "The body is too large.",
    "415": "The body has the wrong media type.",
    "416": "The file has no such range.",
    "422": "A field is wrong; `errors` names it.",
    "429": "The owner of the key has as much as it may; `Retry-After` says when to try again.",
    "503": "The service cannot take the request now; `Retry-After` says when to try again.",
}

LIMITED = (
    *("submit_job", "retry_job", "continue_job", "rerender_image", "submit_campaign", "upload_asset"),
    *("preview_job", "download_export", "download_scene", "download_thumbnail"),
)
"""The operations of which an owner may have only so much."""
EXAMPLES = Path(__file__).with_name("examples.json")
KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "A key that `scene-attack keys create` made. The scope of each operation is listed with it; `admin` "
    "allows all. While there is no key, programs of the service's machine need none.",
}


def describe(app: FastAPI) -> None:
    """Adds the API's description, and its errors as `scene_attack_api.problems` sends them, to the OpenAPI document.

    Adds the examples of `examples.json`, which a service received and answered, by the names of their operations. Calls
    the form of an upload AssetUpload, not by the framework's name for it.
    """
    original = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.description = DESCRIPTION
            schema = original()
            _name_form(schema)
            _add_examples(schema)
            schema["components"] = _for_generators(schema["components"])
            _errors(schema)
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]

    @cache
    def written() -> bytes:
        return json.dumps(openapi(), ensure_ascii=False, separators=(",", ":")).encode()

    @app.get("/openapi.json", include_in_schema=False)
    def document() -> Response:
        return Response(written(), media_type="application/json")


def _name_form(schema: dict[str, Any]) -> None:
    schemas = schema["components"]["schemas"]
    schemas["AssetUpload"] = schemas.pop("Body_upload_asset") | {
        "title": "AssetUpload",
        "description": "A mesh or an environment map, with what is said of it.",
    }
    form = schema["paths"]["/v1/assets"]["post"]["requestBody"]["content"]["multipart/form-data"]
    form["schema"] = {"$ref": "#/components/schemas/AssetUpload"}


def _for_generators(schema: Any) -> Any:
    """The schema in the words that generators of clients read: a file of a form is of format `binary`, and one text
    among other types an `enum`, as they take a `const` for the only type."""
    if isinstance(schema, list):
        return [_for_generators(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    translated = {name: _for_generators(value) for name, value in schema.items()}
    if translated.get("contentMediaType") == "application/octet-stream":
        translated["format"] = "binary"
    if "anyOf" in translated:
        translated["anyOf"] = [
            {"enum": [choice["const"]], "type": choice["type"]} if set(choice) == {"const", "type"} else choice
            for choice in translated["anyOf"]
        ]
    return translated


def _add_examples(schema: dict[str, Any]) -> None:
    operations = {
        operation["operationId"]: operation for methods in schema["paths"].values() for operation in methods.values()
    }
    for name, example in json.loads(EXAMPLES.read_text("utf-8")).items():
        operation = operations[name]
        answers = (answer for status, answer in operation["responses"].items() if status.startswith("2"))
        next(answers)["content"]["application/json"]["example"] = example["answer"]
        if "request" in example:
            operation["requestBody"]["content"]["application/json"]["example"] = example["request"]


def _errors(schema: dict[str, Any]) -> None:
    schemas = schema["components"]["schemas"]
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    own = ProblemDetails.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas |= own.pop("$defs")
    schemas["ProblemDetails"] = own
    schema["components"]["securitySchemes"] = {"key": KEY}
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            scope = scope_of(method.upper(), path)
            operation["security"] = [] if scope is None else [{"key": [scope.value]}]
            answers = operation["responses"]
            if method == "get" and "application/json" in answers.get("200", {}).get("content", {}):
                answers.setdefault("304", {"description": "The client has this answer, by its `If-None-Match`."})
            for status in _possible(method, path, operation):
                answers[status] = {
                    "description": ERRORS[status],
                    "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDetails"}}},
                }
            # What is no HTTP never comes to the code that writes problem documents.
            answers["400"]["content"]["text/plain"] = {"schema": {"type": "string"}}


def _possible(method: str, path: str, operation: dict[str, Any]) -> list[str]:
    statuses = ["400", *(["401", "403", "503"] if operation["security"] else [])]  # the database may not answer
    if "{" in path:
        statuses.append("404")
    if "requestBody" in operation:
        statuses += ["413", "415", "422"]
    elif "422" in operation["responses"]:
        statuses.append("422")
    if method == "delete":
        statuses.append("409")
    if path.endswith(("/export", "/scene.glb", "/continue")):
        statuses.append("409")
    if operation["operationId"] in LIMITED:
        statuses.append("429")
    if "206" in operation["responses"]:
        statuses.append("416")
    return statuses
