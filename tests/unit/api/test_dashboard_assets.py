"""The pages of assets, on the real app."""

from io import BytesIO

import numpy as np
import pytest
from fastapi import FastAPI
from httpx import Client
from PIL import Image

from tests.unit.api.guarded import MESH, Guarded
from tests.unit.api.test_assets import PYRAMID
from tests.unit.api.test_dashboard_pages import Tags


def test_the_grid_shows_what_matches_and_the_first_answers(client: Client, finished: str) -> None:  # noqa: ARG001
    page = Tags(client.get("/assets", params={"kind": "primitive", "q": "sphere"}).text)
    assert "1 – 1 of 1 asset" in page.text
    assert "efficientnet-lite0 says balloon , which is right" in page.text
    links = {a["href"] for a in page.all("a")}
    assert "/assets/primitive/sphere" in links
    assert "/new?mesh=primitive/sphere" in links
    [chosen] = [one for one in page.all("option") if "selected" in one]
    assert chosen is not None
    assert "No asset has all of this" in client.get("/assets", params={"q": "no such thing"}).text


def test_an_asset_s_page_shows_its_jobs(client: Client, finished: str) -> None:
    page = Tags(client.get("/assets/primitive/sphere").text)
    assert "balloon" in page.text
    assert f"/jobs/{finished}" in {a["href"] for a in page.all("a")}
    assert f"/v1/jobs/{finished}/artifacts/original.png" in {image["src"] for image in page.all("img")}
    assert client.get("/assets/uniform").status_code == 200
    assert client.get("/assets/primitive/nothing").status_code == 404


def test_a_furniture_library_s_picture_is_shown(client: Client, app: FastAPI) -> None:
    names = [entry.name for entry in app.state.services.library.entries() if entry.kind == "furniture"]
    if not names:
        pytest.skip("there is no furniture library here")
    shown = client.get(f"/assets/pictures/{names[0]}")
    assert (shown.status_code, shown.headers["content-type"]) == (200, "image/png")
    assert shown.content.startswith(b"\x89PNG")
    assert "default-src 'none'" in shown.headers["content-security-policy"]
    assert f"/assets/pictures/{names[0]}" in client.get("/assets").text


@pytest.mark.parametrize("name", ["furniture/nothing", "primitive/sphere", "nothing", "furniture/..%2f..%2fsecret"])
def test_what_has_no_picture_is_404(client: Client, name: str) -> None:
    assert client.get(f"/assets/pictures/{name}").status_code == 404


def test_an_upload_is_seen_by_its_name_with_what_is_shown_of_it(client: Client) -> None:
    files = [("file", ("p.off", PYRAMID)), ("file", ("p.txt", b"-"))]
    entry = client.post("/v1/assets", files=files, data={"name": "Pyramid"}).json()
    page = client.get(f"/assets/{entry['name']}").text
    assert "<h1>Pyramid</h1>" in page
    assert entry["thumbnail"] in {image["src"] for image in Tags(page).all("img")}
    assert entry["thumbnail"] in client.get("/assets", params={"kind": "upload"}).text
    seen = client.get(entry["thumbnail"])
    assert seen.status_code == 200, seen.text
    pixels = np.asarray(Image.open(BytesIO(seen.content)))
    assert pixels.shape == (192, 192, 3)
    assert len(np.unique(pixels)) > 20
    assert client.delete(f"/v1/assets/{entry['name'].removeprefix('sha256:')}").status_code == 204


@pytest.mark.parametrize("folder", ["", "scenes/"])
def test_an_upload_of_another_owner_is_not_shown(guarded: Guarded, folder: str) -> None:
    answer = guarded.client.get(f"/assets/{folder}sha256:{MESH}", headers=guarded.headers["bob"])
    assert answer.status_code == 404


def test_a_mesh_has_a_scene_and_a_map_has_none(client: Client) -> None:
    page = Tags(client.get("/assets/primitive/sphere").text)
    assert [view["data-before"] for view in page.all("scene-3d")] == ["/assets/scenes/primitive/sphere"]
    assert "/assets/scenes/primitive/sphere" in {link["href"] for link in page.all("a")}
    assert not Tags(client.get("/assets/uniform").text).all("scene-3d")
    assert client.get("/assets/scenes/uniform").status_code == 404
    assert client.get("/assets/scenes/primitive/nothing").status_code == 404
