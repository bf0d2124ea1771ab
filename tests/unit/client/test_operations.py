"""The typed operations against openapi.yaml: nothing left out, nothing that is not there."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from client import AsyncClient, Client, campaign_operations, operations, write_answers
from client.api_client import ApiClient
from client.request import Request

ROOT = Path(__file__).parents[3]
DESCRIPTION = yaml.safe_load((ROOT / "openapi.yaml").read_text("utf-8"))
OPERATIONS = {
    (method.upper(), route): operation
    for route, methods in DESCRIPTION["paths"].items()
    for method, operation in methods.items()
    if method in ("get", "post", "put", "patch", "delete")
}
FUNCTIONS = {
    name: function
    for name, function in inspect.getmembers(operations, inspect.isfunction)
    if function.__module__ in (operations.__name__, campaign_operations.__name__)
}
BODIES = ("spec", "body", "path", "kind", "url")
"""Parameters of functions that go into a request's body."""


def example(function: Callable[..., Request[Any]], tmp_path: Path) -> Request[Any]:
    """The request with a value for every parameter."""
    (tmp_path / "mesh.obj").write_text("o mesh")
    known = {"path": tmp_path / "mesh.obj", "spec": {}, "body": {}, "wait": 5.0}
    return function(**{name: known.get(name, "1") for name in inspect.signature(function).parameters})


def test_the_types_are_those_of_openapi_yaml() -> None:
    said = "write it again with: python -m client.write_answers > client/answers.pyi"
    assert (ROOT / "client" / "answers.pyi").read_text("utf-8") == write_answers.written(DESCRIPTION), said


def test_every_operation_has_one_function(tmp_path: Path) -> None:
    offered = sorted((found.method, found.route) for found in (example(f, tmp_path) for f in FUNCTIONS.values()))
    assert offered == sorted(OPERATIONS)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_function_has_the_name_of_its_operation(name: str, tmp_path: Path) -> None:
    request = example(FUNCTIONS[name], tmp_path)
    assert OPERATIONS[request.method, request.route]["operationId"] == name


@pytest.mark.parametrize("kind", [ApiClient, AsyncClient, Client])
def test_a_method_of_a_client_has_the_name_of_its_operation(kind: type) -> None:
    methods = {name for name in vars(kind) if not name.startswith("_")}
    assert methods - set(FUNCTIONS) <= {"call", "url", "all_jobs", "ready"}


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_function_has_every_parameter_and_the_type_of_the_answer(name: str, tmp_path: Path) -> None:
    function = FUNCTIONS[name]
    request = example(function, tmp_path)
    operation = OPERATIONS[request.method, request.route]
    described = {one["name"].lower() for one in operation.get("parameters", ())}
    assert {one.lower() for one in (*request.path, *request.params, *request.headers)} == described
    assert ("requestBody" in operation) == bool(set(inspect.signature(function).parameters) & set(BODIES))
    success = next(one for status, one in operation["responses"].items() if status in ANSWERS)
    assert function.__annotations__["return"] == f"Request[{answer(success.get('content', {}))}]"


ANSWERS = ("200", "201", "202", "204")


BYTES = ("application/octet-stream", "image/png", "application/zip", "model/gltf-binary", "text/event-stream")


def answer(content: dict[str, Any]) -> str:
    """The type of an operation's answer."""
    if not content:
        return "None"
    kind, body = next(iter(content.items()))
    if kind == "application/json":
        return write_answers.type_of(body["schema"])
    return "bytes" if kind in BYTES else "str"


def test_a_name_in_a_path_is_quoted() -> None:
    assert operations.download_artifact("../keys", "a b").address == "/v1/jobs/..%2Fkeys/artifacts/a%20b"


def test_what_is_not_given_is_not_sent() -> None:
    assert operations.list_jobs(limit=3).arguments() == {"method": "GET", "url": "/v1/jobs", "params": {"limit": 3}}
    sent = operations.submit_job({}, wait=2.0).arguments()
    assert sent["headers"] == {"Prefer": "wait=2"}
    assert "params" not in sent


def test_a_mesh_is_sent_with_the_files_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "chair.obj").write_text("mtllib chair.mtl\n")
    (tmp_path / "chair.mtl").write_text("newmtl a\n")
    (tmp_path / "other.mtl").write_text("newmtl b\n")
    sent = operations.upload_asset(tmp_path / "chair.obj", name="Chair", up="z").arguments()
    assert sent["files"] == [("file", ("chair.obj", b"mtllib chair.mtl\n")), ("file", ("chair.mtl", b"newmtl a\n"))]
    assert sent["data"] == {"name": "Chair", "up": "z"}
