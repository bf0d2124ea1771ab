"""A network whose weights are published, and not on this machine: lists say so, and a request is answered at once."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from httpx import Client
from typer.testing import CliRunner

from scene_attack.cli.app import app
from scene_attack.process import options
from scene_attack.targets.image_networks import ALEXNET
from scene_attack.targets.info import TARGETS, Published, register
from scene_attack.targets.labels import imagenet_labels

SOURCE = "http://127.0.0.1:9/net-00.pth"
"""Nothing listens at this port."""
SAID = f"its weights are not here yet; the first job fetches {SOURCE} into weights/ of SCENE_ATTACK_CACHE"


@pytest.fixture(autouse=True)
def _network() -> Iterator[None]:
    before = TARGETS.snapshot()
    card = ALEXNET.model_copy(update={"name": "far-away", "source": SOURCE})
    register(card, imagenet_labels, Published(SOURCE))(lambda _: pytest.fail("it was loaded"))
    yield
    TARGETS.restore(before)


def test_lists_say_what_is_missing_and_how_to_get_it(client: Client) -> None:
    listed = {one["name"]: one["missing"] for one in client.get("/v1/targets").json()["items"]}
    assert listed["far-away"] == SAID
    assert listed["efficientnet-lite0"] is None
    assert SAID in client.get("/targets").text
    assert f"far-away: {SAID}" in CliRunner().invoke(app, ["targets"]).output


def test_a_file_that_is_there_is_not_missing(client: Client) -> None:
    path = Path(options().cache_dir / "weights" / "net-00.pth")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    try:
        listed = {one["name"]: one["missing"] for one in client.get("/v1/targets").json()["items"]}
    finally:
        path.unlink()
    assert listed["far-away"] is None


def test_a_request_is_refused_before_it_is_queued_with_all_else_that_is_wrong(client: Client) -> None:
    request = {"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "target": {"name": "far-away"}}
    for path in ("/v1/jobs", "/v1/preview"):
        answer = client.post(path, json=request)
        assert answer.status_code == 422
        [error] = answer.json()["errors"]
        assert error["field"] == "target.name"
        assert error["detail"].startswith(f"{SAID}, which cannot be reached (ConnectError")
    answer = client.post("/v1/jobs", json=request | {"seed": -1})
    assert {error["field"] for error in answer.json()["errors"]} == {"target.name", "seed"}
