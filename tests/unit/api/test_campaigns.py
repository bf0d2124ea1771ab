"""The routes of campaigns, over HTTP; no worker runs, so a test moves campaigns on itself."""

from copy import deepcopy
from typing import Any

import pytest
from httpx import Client

from scene_attack_api.requests import Services

SPEC: dict[str, Any] = {
    "name": "spheres",
    "grids": [
        {
            "scenes": {
                "meshes": ["primitive/sphere"],
                "views": [0.1, 0.2],
                "camera": {"size": [32, 32]},
            },
            "attacks": [{"name": "pose", "attack": {"renderer": "pyrender", "groups": ["rotation"], "steps": 1}}],
        }
    ],
}


def changed(**values: Any) -> dict[str, Any]:
    spec = deepcopy(SPEC)
    spec["grids"][0] |= values
    return spec


def start(client: Client, spec: dict[str, Any] = SPEC, **headers: str) -> dict[str, Any]:
    answer = client.post("/v1/campaigns", json=spec, headers=headers)
    assert answer.status_code == 202, answer.text
    found: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"/v1/campaigns/{found['id']}"
    return found


def test_a_campaign_is_accepted_and_echoes_the_whole_request(client: Client) -> None:
    found = start(client)
    assert (found["state"], found["name"]) == ("selecting", "spheres")
    assert found["progress"] == {"views": 2, "answered": 0, "jobs": 0, "ended": 0, "running": 0}
    assert found["spec"]["grids"][0]["selection"]["right"] is True
    assert found["spec"]["grids"][0]["scenes"]["camera"]["distance"] == 1.8
    assert client.get(f"/v1/campaigns/{found['id']}").json() == found
    assert client.get("/v1/campaigns", params={"limit": 1}).json()["items"][0]["id"] == found["id"]


def test_a_key_gets_the_first_answer_and_no_second_campaign(client: Client) -> None:
    key = {"Idempotency-Key": "campaign"}
    first = start(client, **key)
    client.post(f"/v1/campaigns/{first['id']}/cancel")
    assert start(client, **key) == first
    answer = client.post("/v1/campaigns", json=changed(seeds=[1]), headers=key)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "Idempotency-Key"


@pytest.mark.parametrize(
    ("data", "field", "words"),
    [
        ({}, "grids", "needs a grid"),
        (
            changed(attacks=[{"name": "a", "attack": {"renderer": "no"}}]),
            "grids.0.attacks.0.attack.renderer",
            "no 'no'",
        ),
        (changed(scenes={"meshes": ["primitive/spher"]}), "grids.0.scenes.meshes.0", "did you mean 'primitive/sphere'"),
        (changed(scenes={"meshes": ["primitive/cube"], "material": "wod"}), "grids.0.scenes.material", "glossy-paint"),
        (changed(targets=["efficientnet-lite9"]), "grids.0.targets.0.name", "no target"),
        (changed(goal={"reach": "no label"}), "grids.0.goal.reach", "has no label"),
        (
            changed(scenes={"meshes": ["primitive/cube"], "views": {"random": 1000}}, seeds=list(range(11))),
            "grids",
            "11,000",
        ),
        ({"jobs": [{"scene": {"objects": [{"mesh": "primitive/spher"}]}}]}, "jobs.0.scene.objects.0.mesh", "sphere"),
    ],
)
def test_a_bad_request_is_refused_with_its_field(client: Client, data: dict[str, Any], field: str, words: str) -> None:
    answer = client.post("/v1/campaigns", json=data)
    assert answer.status_code == 422
    [error] = answer.json()["errors"]
    assert error["field"] == field
    assert words in error["detail"]


def test_campaigns_are_listed_in_pages(client: Client) -> None:
    made = [start(client)["id"] for _ in range(3)]
    found: list[str] = []
    cursor = None
    while len(found) < 3:
        page = client.get("/v1/campaigns", params={"limit": 2} | ({} if cursor is None else {"cursor": cursor})).json()
        found += [one["id"] for one in page["items"]]
        cursor = page["next"]
    assert found[:3] == made[::-1]
    assert client.get("/v1/campaigns", params={"cursor": "?"}).status_code == 422


def test_a_campaign_is_paused_resumed_and_cancelled(client: Client) -> None:
    campaign = f"/v1/campaigns/{start(client)['id']}"
    states = [
        client.post(f"{campaign}/{move}").json()["state"] for move in ("pause", "pause", "resume", "cancel", "resume")
    ]
    assert states == ["paused", "paused", "selecting", "cancelled", "cancelled"]
    listed = client.get("/v1/campaigns", params={"state": "cancelled", "limit": 1}).json()["items"]
    assert campaign.endswith(listed[0]["id"])


def test_the_table_is_there_from_the_start(client: Client) -> None:
    campaign = f"/v1/campaigns/{start(client)['id']}"
    assert client.get(f"{campaign}/table.json").json() == {
        "table": {"campaign": "spheres", "targets": [], "attacks": [], "cells": []},
        "curves": [],
        "views": [],
    }
    found = client.get(f"{campaign}/table.csv")
    assert found.headers["content-type"].startswith("text/csv")
    assert found.text.startswith("campaign,target,attack,")
    found = client.get(f"{campaign}/table.tex")
    assert found.headers["content-type"].startswith("text/x-tex")
    assert "booktabs" in found.text
    assert client.get(f"{campaign}/views").json() == {"items": []}
    assert client.get(f"{campaign}/jobs").json() == {"items": [], "next": None}


def test_its_page_shows_it(client: Client, services: Services) -> None:
    campaign = start(client, SPEC | {"name": "<script>alert(1)</script>"})["id"]
    for path in ("/campaigns", "/parts/campaigns", f"/campaigns/{campaign}", f"/parts/campaigns/{campaign}"):
        page = client.get(path)
        assert page.status_code == 200, path
        assert "<script>alert" not in page.text
        assert "&lt;script&gt;alert" in page.text
    assert client.get("/campaigns/none").status_code == 404
    moved = client.post(f"/campaigns/{campaign}/pause")
    assert (moved.status_code, moved.headers["location"]) == (303, f"/campaigns/{campaign}")
    assert "Resume" in client.get(f"/campaigns/{campaign}").text
    assert client.post(f"/campaigns/{campaign}/eat").status_code == 404
    found = services.record.campaigns.get(campaign)
    assert found is not None
    assert found.state.value == "paused"
