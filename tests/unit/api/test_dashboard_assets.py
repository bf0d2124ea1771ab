"""The pages of assets, on the real app."""

from io import BytesIO

import numpy as np
import pytest
from fastapi import FastAPI
from httpx import Client
from PIL import Image

from tests.unit.api.dashboard_records import Tags
from tests.unit.api.guarded import MESH, Guarded
from tests.unit.api.test_assets import PYRAMID
from tests.unit.api.test_sign_in import FOREIGN
from tests.unit.scenes.test_companion_files import MTL, OBJ, image

pytestmark = pytest.mark.slow

HTML = {"accept": "text/html"}
MESH_FILES = [("file", ("chair.obj", OBJ)), ("file", ("my chair.mtl", MTL)), ("file", ("wood.png", image()))]


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


def test_a_primitive_s_picture_is_drawn(client: Client) -> None:
    seen = client.get("/assets/pictures/primitive/torus")
    assert seen.status_code == 200, seen.text
    pixels = np.asarray(Image.open(BytesIO(seen.content)))
    assert pixels.shape == (192, 192, 3)
    assert pixels.std() > 5  # it is there


@pytest.mark.parametrize(
    "name", ["furniture/nothing", "primitive/nothing", "sphere", "uniform", "furniture/..%2f..%2fsecret"]
)
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


def test_the_form_adds_a_mesh_with_its_files_and_leads_to_its_page(client: Client) -> None:
    form = {"name": "", "up": "z", "licence": "CC BY 4.0", "credit": "", "mesh": ""}
    answer = client.post("/assets", files=MESH_FILES, data=form, headers=HTML)
    assert answer.status_code == 303, answer.text
    place = answer.headers["location"]
    about = {"name": "chair", "up": "z", "licence": "CC BY 4.0"}
    same = client.post("/v1/assets", files=MESH_FILES, data=about).json()
    assert place == f"/assets/{same['name']}"
    assert same["used"] == ["material library my chair.mtl", "texture wood.png"]
    assert "<h1>chair</h1>" in client.get(place).text
    assert client.delete(f"/v1/assets/{same['name'].removeprefix('sha256:')}").status_code == 204


WRONG = {
    "damaged": ([("file", ("p.obj", b"v 0 0 zero\nf 1 2"))], {}, "file"),
    "no mesh": ([("file", ("p.txt", PYRAMID))], {}, "kind"),
    "two meshes": ([("file", ("a.off", PYRAMID)), ("file", ("b.off", PYRAMID))], {}, "mesh"),
    "an axis": ([("file", ("p.off", PYRAMID))], {"up": "x"}, "up"),
    "a long name": ([("file", ("p.off", PYRAMID))], {"name": "x" * 101}, "name"),
    "two lines": ([("file", ("p.off", PYRAMID))], {"credit": "a\nb"}, "credit"),
}


@pytest.mark.parametrize(("files", "form", "field"), WRONG.values(), ids=WRONG)
def test_files_that_cannot_be_added_are_explained_at_the_form(
    client: Client, files: list[tuple[str, tuple[str, bytes]]], form: dict[str, str], field: str
) -> None:
    before = client.get("/v1/assets").json()
    answer = client.post("/assets", files=files, data={"licence": "CC0 <1>", **form}, headers=HTML)
    assert answer.status_code == 422
    assert answer.headers["content-type"].startswith("text/html")
    page = Tags(answer.text)
    assert f"{field} :" in page.text, page.text
    assert "Traceback" not in answer.text
    assert "open" in next(one for one in page.all("details") if one.get("id") == "add")
    [licence] = [one for one in page.all("input") if one.get("id") == "add-licence"]
    assert licence["value"] == "CC0 <1>", "what was written is kept"
    assert client.get("/v1/assets").json() == before


def test_a_form_without_a_file_is_explained(client: Client) -> None:
    empty = (
        b'--x\r\nContent-Disposition: form-data; name="file"; filename=""\r\n\r\n\r\n--x--\r\n'  # as browsers send it
    )
    kind = {"content-type": "multipart/form-data; boundary=x"}
    answer = client.post("/assets", content=empty, headers=HTML | kind)
    assert (answer.status_code, "choose the file of a mesh" in answer.text) == (422, True)


def test_the_form_takes_as_many_bytes_as_the_api(client: Client) -> None:
    sent = [("file", ("p.off", PYRAMID + b"#" * 400_000))]
    answer = client.post("/assets", files=sent, headers=HTML)
    assert (answer.status_code, "300,000 bytes" in answer.text) == (422, True)
    assert client.post("/assets", files=[("file", ("p.off", PYRAMID + b"#" * 200_000))]).status_code == 303
    assert client.post("/assets", data={"name": "p"}).status_code == 415


@pytest.mark.parametrize("headers", FOREIGN.values(), ids=FOREIGN)
def test_another_site_cannot_add_a_mesh(client: Client, headers: dict[str, str]) -> None:
    before = client.get("/v1/assets").json()
    assert client.post("/assets", files=MESH_FILES, headers=headers).status_code == 403
    assert client.get("/v1/assets").json() == before


def test_only_who_may_upload_has_the_form(guarded: Guarded) -> None:
    reader, writer = guarded.headers["only jobs:read"], guarded.headers["bob"]
    assert "add-file" not in guarded.client.get("/assets", headers=reader).text
    assert "add-file" in guarded.client.get("/assets", headers=writer).text
    assert guarded.client.post("/assets", files=MESH_FILES, headers=reader).status_code == 403
    place = guarded.client.post("/assets", files=MESH_FILES, headers=writer).headers["location"]
    assert guarded.client.get(place, headers=writer).status_code == 200
    assert guarded.client.get(place, headers=guarded.headers["alice"]).status_code == 404
