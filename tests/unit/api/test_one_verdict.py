"""A request that cannot run is refused for the same fields wherever it is given."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from httpx import Client
from typer.testing import CliRunner

import scene_attack as sa
from scene_attack.cli.app import app
from scene_attack.errors import InvalidRequest

pytestmark = pytest.mark.slow

SPHERE: dict[str, Any] = {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [32, 32]}}
ATTACK: dict[str, Any] = {"renderer": "image", "base_renderer": "pyrender", "steps": 2}
BAD: dict[str, tuple[set[str], dict[str, Any]]] = {
    "a label that is none": ({"goal.truth"}, {"goal": {"truth": "piano"}}),
    "labels among others": (
        {"goal.leave.0", "goal.leave.2", "goal.reach"},
        {"goal": {"leave": ["nothing", "cup", "none"], "reach": 1000}},
    ),
    "an object out of view": (
        {"scene.objects.0"},
        {"scene": SPHERE | {"objects": [{"mesh": "primitive/sphere", "translation": [50, 0, 0]}]}},
    ),
    "names and a number": (
        {
            "scene.objects.0.mesh",
            "scene.objects.0.material",
            "scene.lights.environment.map",
            "analysis.transfer.targets.0",
            "attack.steps",
            "attack.groups",
        },
        {
            "scene": SPHERE
            | {
                "objects": [{"mesh": "primitive/shere", "material": "plastik"}],
                "lights": {"environment": {"map": "studeo"}},
            },
            "analysis": {"transfer": {"targets": ["nosuch"]}},
            "attack": ATTACK | {"steps": -3, "groups": ["normal"]},
        },
    ),
    "misspelt fields": (
        {"gaol", "sead", "scene.camra", "scene.objects.0.materiel", "attack.method", "attack.stepz"},
        {
            "gaol": {},
            "sead": 1,
            "scene": {"camra": {}, "objects": [{"mesh": "primitive/sphere", "materiel": "matte"}]},
            "attack": {"method": "fgsmm", "stepz": 3},
        },
    ),
}
"""Some are refused by the request's models, some once its labels are known, and some when the scene is drawn."""


def request_of(name: str) -> dict[str, Any]:
    return {"scene": SPHERE, "attack": ATTACK} | BAD[name][1]


def by_command(folder: Path, *command: str) -> Callable[[dict[str, Any]], set[str]]:
    def refused(request: dict[str, Any]) -> set[str]:
        (folder / "spec.json").write_text(json.dumps(request))
        done = CliRunner().invoke(app, [*command, str(folder / "spec.json")])
        assert isinstance(done.exception, InvalidRequest), done.output
        return {error.field for error in done.exception.every}

    return refused


def by_post(client: Client, path: str) -> Callable[[dict[str, Any]], set[str]]:
    def refused(request: dict[str, Any]) -> set[str]:
        answer = client.post(path, json=request)
        assert answer.status_code == 422, answer.text
        return {error["field"] for error in answer.json()["errors"]}

    return refused


@pytest.fixture(params=["run", "plan", "render", "campaign run", "jobs", "preview", "campaigns"])
def door(
    request: pytest.FixtureRequest, tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> Callable[[dict[str, Any]], set[str]]:
    """Takes a job, and returns the fields for which it is refused."""
    monkeypatch.setattr("scene_attack.cli.commands.run.keep_memory", lambda: None)

    def of_campaign(refused: Callable[[dict[str, Any]], set[str]]) -> Callable[[dict[str, Any]], set[str]]:
        return lambda job: {field.removeprefix("jobs.0.") for field in refused({"jobs": [job]})}

    doors = {
        "run": by_command(tmp_path, "run", "--out", str(tmp_path / "out")),
        "plan": by_command(tmp_path, "plan"),
        "render": by_command(tmp_path, "render"),
        "campaign run": of_campaign(by_command(tmp_path, "campaign", "run", "--out", str(tmp_path / "out"))),
        "jobs": by_post(client, "/v1/jobs"),
        "preview": by_post(client, "/v1/preview"),
        "campaigns": of_campaign(by_post(client, "/v1/campaigns")),
    }
    return doors[request.param]


@pytest.mark.parametrize("name", BAD)
def test_the_same_fields_are_refused_at_every_door(name: str, door: Callable[[dict[str, Any]], set[str]]) -> None:
    assert door(request_of(name)) == BAD[name][0]


@pytest.mark.parametrize("name", BAD)
def test_attack_of_python_refuses_them_too(name: str) -> None:
    model = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 1000))
    target = sa.target(model, labels="imagenet", preprocessing={"input_size": [8, 8]})
    request: dict[str, Any] = {"scene": None, "target": target} | request_of(name)
    with pytest.raises(InvalidRequest) as refused:
        sa.attack(**request)
    assert {error.field for error in refused.value.every} == BAD[name][0]
