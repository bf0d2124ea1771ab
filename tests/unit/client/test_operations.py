"""The table of operations against openapi.yaml: nothing left out, nothing that is not there."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import yaml

from scene_attack import AsyncClient, Client
from scene_attack.client import operations
from scene_attack.client.operations import Request
from scene_attack.client.schemas import JobEdit
from scene_attack.runs.spec import parse
from tests.unit.client.scripted_service import EXAMPLES

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
    if not name.startswith("_") and function.__module__ == operations.__name__
}
SPHERE = {"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "attack": {"renderer": "image"}}
BODIES = ("spec", "body", "files")
"""Parameters of functions that go into a request's body."""


def example(function: Callable[..., Request[Any]], tmp_path: Path) -> Request[Any]:
    """The request with a value for every parameter."""
    (tmp_path / "mesh.obj").write_text("o mesh")
    known = {"files": [tmp_path / "mesh.obj"], "spec": {}, "body": {}, "wait": 5.0}
    names = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            [keywords] = get_args(get_type_hints(function)[parameter.name])
            names += keywords.__annotations__
        else:
            names.append(parameter.name)
    return function(**{name: known.get(name, "1") for name in names})


def test_every_operation_has_one_function(tmp_path: Path) -> None:
    offered = sorted((found.method, found.route) for found in (example(f, tmp_path) for f in FUNCTIONS.values()))
    assert offered == sorted(OPERATIONS)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_function_has_the_name_of_its_operation(name: str, tmp_path: Path) -> None:
    request = example(FUNCTIONS[name], tmp_path)
    assert OPERATIONS[request.method, request.route]["operationId"] == name


@pytest.mark.parametrize("kind", [AsyncClient, Client])
def test_a_method_of_a_client_has_the_name_of_its_operation(kind: type) -> None:
    methods = {name for name in vars(kind) if not name.startswith("_")}
    assert methods - set(FUNCTIONS) <= {"call", "save", "url", "submit"}


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_function_has_every_parameter_and_the_models_of_body_and_answer(name: str, tmp_path: Path) -> None:
    function = FUNCTIONS[name]
    request = example(function, tmp_path)
    operation = OPERATIONS[request.method, request.route]
    described = {one["name"].lower() for one in operation.get("parameters", ())}
    assert {one.lower() for one in (*request.path, *request.params, *request.headers)} == described
    success = next(one for status, one in operation["responses"].items() if status in ANSWERS)
    assert request.answer.__name__ == answer(success.get("content", {}))
    declared = get_type_hints(function).get("return")  # a row of the table has the type of its model
    assert declared in (None, Request[request.answer])  # type: ignore[name-defined]
    body = operation.get("requestBody", {"content": {}})["content"]
    given = [function.__annotations__[one] for one in inspect.signature(function).parameters if one in BODIES]
    if "application/json" in body:
        assert given == [f"{model(body['application/json'])} | Mapping[str, Any]"]
    else:
        assert bool(given) == bool(body)


ANSWERS = ("200", "201", "202", "204")
BYTES = ("application/octet-stream", "image/png", "application/zip", "model/gltf-binary", "text/event-stream")


def model(content: dict[str, Any]) -> str:
    return str(content["schema"]["$ref"]).rpartition("/")[2]


def answer(content: dict[str, Any]) -> str:
    """The name of an operation's answer: its model, or the type of what is no JSON."""
    if not content:
        return "NoneType"
    kind, body = next(iter(content.items()))
    if kind == "application/json":
        return model(body)
    return "bytes" if kind in BYTES else "str"


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_a_recorded_answer_is_read_whole(name: str, tmp_path: Path) -> None:
    model = example(FUNCTIONS[name], tmp_path).answer
    assert model.model_validate(EXAMPLES[name]["answer"]).model_dump(mode="json") == EXAMPLES[name]["answer"]


def test_an_edit_leaves_the_fields_alone_that_were_not_given() -> None:
    assert operations.edit_job("1", JobEdit(title=None, note="x")).arguments()["json"] == {"title": None, "note": "x"}
    assert operations.submit_job(parse(SPHERE)).arguments()["json"]["attack"]["method"] == "fgsm"


def test_a_name_in_a_path_is_quoted() -> None:
    assert operations.download_artifact("../keys", "a b").address == "/v1/jobs/..%2Fkeys/artifacts/a%20b"


def test_what_is_not_given_is_not_sent() -> None:
    assert operations.list_jobs(limit=3).arguments() == {"method": "GET", "url": "/v1/jobs", "params": {"limit": 3}}
    sent = operations.submit_job({}, wait=2.0).arguments()
    assert sent["headers"] == {"Prefer": "wait=2"}
    assert "params" not in sent


def test_an_argument_that_is_misspelt_is_refused() -> None:
    for misspelt in (lambda: operations.list_jobs(stat="failed"), lambda: operations.submit_job({}, priorty="high")):
        with pytest.raises(TypeError, match="there is no argument"):
            misspelt()


def test_a_mesh_is_sent_with_the_files_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "chair.obj").write_text("mtllib chair.mtl\n")
    (tmp_path / "chair.mtl").write_text("newmtl a\n")
    (tmp_path / "other.mtl").write_text("newmtl b\n")
    sent = operations.upload_asset([tmp_path / "chair.obj"], name="Chair", up="z").arguments()
    assert sent["files"] == [("file", ("chair.obj", b"mtllib chair.mtl\n")), ("file", ("chair.mtl", b"newmtl a\n"))]
    assert sent["data"] == {"mesh": "chair.obj", "name": "Chair", "up": "z"}
