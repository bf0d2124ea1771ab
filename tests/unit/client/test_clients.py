"""`Client` and `AsyncClient` against a service on a real socket that answers what each test scripts."""

import asyncio
import io
import json
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from types import SimpleNamespace

import httpx
import numpy as np
import PIL.Image
import pytest
import torch

import scene_attack as sa
from scene_attack import ApiError, AsyncClient, Client, Unfinished, images
from scene_attack.client import operations
from scene_attack.client.client import AsyncJob
from scene_attack.errors import InvalidRequest
from scene_attack.extras import MissingExtra
from tests.unit.client.scripted_service import (
    CAMPAIGN,
    DONE,
    EXAMPLES,
    RUNNING,
    SUCCEEDED,
    UPLOADED,
    Answer,
    Script,
    client,
    job,
    progress,
    says,
    script,
    streams,
)

pytestmark = pytest.mark.slow

__all__ = ["client", "script"]  # fixtures

ID = SUCCEEDED["id"]
PIXELS = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
NOT_FOUND = {"status": 404, "title": "Not Found", "detail": "there is no such job"}
BUSY = says(503, b"Service Unavailable", "text/plain; charset=utf-8")  # of uvicorn, above limit_concurrency


def png() -> bytes:
    file = io.BytesIO()
    PIL.Image.fromarray(PIXELS).save(file, "PNG")
    return file.getvalue()


def test_a_job_is_submitted_watched_and_read(client: Client, script: Script) -> None:
    script.answers = [
        says(202, job()), streams(RUNNING, progress(2), drop=True), streams(DONE), says(200, SUCCEEDED),
        says(200, png(), "image/png"), says(200, b'{"a": 1}'),
    ]  # fmt: skip
    found = client.submit({"scene": {}}, priority="high").wait()
    assert found.data.model_dump(mode="json") == SUCCEEDED
    assert found.verified == SUCCEEDED["result"]["verdict"]["verified"]
    assert [row.step for row in found.trace] == [row["step"] for row in SUCCEEDED["result"]["trace"]]
    assert (np.asarray(found.images.attacked) == PIXELS).all()
    assert found.images.attacked is found.images.attacked  # it is read once
    assert found.file("settings.json") == b'{"a": 1}'  # a file is bytes, whatever it holds
    assert script.paths == [
        "POST /v1/jobs?priority=high", f"GET /v1/jobs/{ID}/events", f"GET /v1/jobs/{ID}/events", f"GET /v1/jobs/{ID}",
        f"GET /v1/jobs/{ID}/artifacts/attacked.png", f"GET /v1/jobs/{ID}/artifacts/settings.json",
    ]  # fmt: skip


def test_the_same_by_asyncio(client: Client, script: Script) -> None:
    script.answers = [
        says(202, job()), streams(RUNNING, progress(2), drop=True), streams(DONE), says(200, SUCCEEDED),
        *[says(200, png(), "image/png")] * 2,
    ]  # fmt: skip

    async def run() -> None:
        async with AsyncClient(client.url) as service:
            found = await (await service.submit({"scene": {}})).wait()
            assert found.data.model_dump(mode="json") == SUCCEEDED
            for _ in range(2):
                assert (np.asarray(await found.images.attacked) == PIXELS).all()

    asyncio.run(run())
    taken_up = [headers.get("last-event-id") or headers.get("Last-Event-ID") for _, _, headers in script.seen[1:3]]
    assert taken_up == [None, "2"]
    assert len(script.pauses) == 1


def test_a_dropped_stream_is_taken_up_after_the_last_event(client: Client, script: Script) -> None:
    script.answers = [streams(RUNNING, progress(2), drop=True), streams(DONE)]
    assert [event.number for event in client.stream_job_events("j")] == ["1", "2", "3"]
    assert "Last-Event-ID" not in script.seen[0][2]
    assert script.seen[1][2]["Last-Event-ID"] == "2"


def test_a_stream_that_ends_before_the_job_is_taken_up_too(client: Client, script: Script) -> None:
    script.answers = [streams(RUNNING), streams(progress(2)), streams(DONE)]
    assert [event.kind for event in client.stream_job_events("j")] == ["state", "progress", "state"]
    assert [headers.get("Last-Event-ID") for _, _, headers in script.seen] == [None, "1", "2"]


def test_signs_of_life_are_not_events(client: Client, script: Script) -> None:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", "text/event-stream")
        handler.end_headers()
        handler.wfile.write(b'id: 1\nevent: state\ndata: {"state": "running"}\n\n: ping\n\n: ping\n\n')

    script.answers = [answer, streams(DONE)]
    assert [event.number for event in client.stream_job_events("j")] == ["1", "3"]


def test_nothing_left_to_hear_is_the_end(client: Client, script: Script) -> None:
    script.answers = [lambda handler: (handler.send_response(204), handler.end_headers())[0]]
    assert list(client.stream_job_events("j", after="3")) == []


async def events_by_asyncio(url: str) -> None:
    async with AsyncClient(url) as service:
        async for _ in service.stream_job_events("j"):
            pass


@pytest.mark.parametrize("broken", [streams(drop=True), streams()])
def test_a_stream_that_never_gets_anywhere_is_given_up(client: Client, script: Script, broken: Answer) -> None:
    script.answers = [broken] * 30
    with pytest.raises(httpx.RemoteProtocolError):
        list(client.stream_job_events("j"))
    assert len(script.seen) == 9
    with pytest.raises(httpx.RemoteProtocolError):
        asyncio.run(events_by_asyncio(client.url))
    assert len(script.seen) == 18


def test_a_stream_of_an_unknown_job_is_refused_at_once(client: Client, script: Script) -> None:
    script.answers = [says(404, NOT_FOUND)] * 2
    with pytest.raises(ApiError, match="there is no such job") as refused:
        list(client.stream_job_events("j"))
    assert refused.value.status == 404
    with pytest.raises(ApiError, match="there is no such job"):
        asyncio.run(events_by_asyncio(client.url))


def test_a_busy_service_is_asked_again(client: Client, script: Script) -> None:
    full = says(503, {"detail": "as many jobs are queued as this service takes"}, Retry_After="4")
    script.answers = [BUSY, full, says(202, job())]
    assert client.submit({}).id == ID
    assert script.pauses == [1.0, 4.0]
    script.answers = [BUSY, streams(RUNNING), BUSY, streams(DONE)]
    assert [event.number for event in client.stream_job_events("j")] == ["1", "3"]
    script.answers = [BUSY] * 6
    with pytest.raises(ApiError, match=r"^the service at http://127\.0\.0\.1:\d+ is busy \(HTTP 503\); try again"):
        client.get_job("j")

    async def by_asyncio() -> None:
        async with AsyncClient(client.url) as service:
            with pytest.raises(ApiError, match="is busy"):
                await service.get_job("j")

    asyncio.run(by_asyncio())
    assert script.answers == []


def test_an_answer_that_it_is_not_ready_is_not_asked_for_again(client: Client, script: Script) -> None:
    script.answers = [says(503, EXAMPLES["get_readiness"]["answer"] | {"ready": False})]
    with pytest.raises(ApiError) as refused:
        client.call(operations.get_readiness())
    assert refused.value.status == 503
    assert script.pauses == []


def test_a_refusal_names_every_bad_field(client: Client, script: Script) -> None:
    problem = {
        "status": 422,
        "detail": "…",
        "errors": [{"field": "scene.objects.0.mesh", "detail": "no"}, {"field": "seed", "detail": "negative"}],
    }
    script.answers = [says(422, problem, "application/problem+json")]
    with pytest.raises(ApiError) as refused:
        client.submit({})
    assert str(refused.value) == "scene.objects.0.mesh: no; seed: negative"
    assert refused.value.problem == problem


def test_an_error_that_is_no_problem_document_is_still_an_error(client: Client, script: Script) -> None:
    script.answers = [says(502, b"<html>bad gateway", "text/html")]
    with pytest.raises(ApiError, match="HTTP 502"):
        client.get_job("j")


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (says(200, b"<html>welcome", "text/html"), "answered HTTP 200 with text/html, not JSON"),
        (says(200, b"[]"), "answered no JobView of this version (the whole: "),
        (says(200, job(state="waiting")), "answered no JobView of this version (state: "),
    ],
)
def test_what_is_no_answer_says_what_it_is(client: Client, script: Script, answer: Answer, words: str) -> None:
    script.answers = [answer]
    with pytest.raises(httpx.DecodingError) as error:
        client.get_job("j")
    assert words in str(error.value)


def test_fields_that_a_newer_service_adds_are_left_out(client: Client, script: Script) -> None:
    result = SUCCEEDED["result"] | {"mood": "good"}
    script.answers = [says(200, SUCCEEDED | {"colour": "red", "result": result})]
    assert client.get_job("j").data.model_dump(mode="json") == SUCCEEDED


def test_a_download_that_breaks_leaves_no_file(client: Client, script: Script, tmp_path: Path) -> None:
    def broken(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Length", "1000")
        handler.end_headers()
        handler.wfile.write(b"half")

    script.answers = [broken, says(404, NOT_FOUND), says(200, b"whole", "image/png")]
    request = operations.download_artifact("j", "attacked.png")
    for error in (httpx.TransportError, ApiError):
        with pytest.raises(error):
            client.save(request, tmp_path / "attacked.png")
        assert not (tmp_path / "attacked.png").exists()
    client.save(request, tmp_path / "attacked.png")
    assert (tmp_path / "attacked.png").read_bytes() == b"whole"
    assert [path.name for path in tmp_path.iterdir()] == ["attacked.png"]


def test_all_pages_of_a_list_are_read(client: Client, script: Script) -> None:
    pages = [says(200, {"items": [job(id="1")], "next": "c"}), says(200, {"items": [job(id="2")], "next": None})]
    script.answers = pages * 2

    async def by_asyncio() -> list[str]:
        async with AsyncClient(client.url) as service:
            return [found.id async for found in service.list_jobs(state="failed")]

    assert [found.id for found in client.list_jobs(state="failed")] == ["1", "2"]
    assert asyncio.run(by_asyncio()) == ["1", "2"]
    paths = ["GET /v1/jobs?state=failed&limit=200", "GET /v1/jobs?state=failed&limit=200&cursor=c"]
    assert script.paths == paths * 2


def test_every_kind_of_answer_is_read(client: Client, script: Script) -> None:
    script.answers = [says(200, {"items": []}), says(200, b"a,b\n", "text/csv"), says(204, b""), says(202, CAMPAIGN)]
    assert client.call(operations.list_targets()).items == []
    assert client.call(operations.get_campaign_table_csv("1")) == "a,b\n"
    client.call(operations.delete_asset("sha256:1"))
    assert client.submit_campaign({}, priority="normal").model_dump(mode="json") == CAMPAIGN
    assert script.paths[-1] == "POST /v1/campaigns?priority=normal"


def test_files_are_written_into_the_folder_whatever_their_names(client: Client, script: Script, tmp_path: Path) -> None:
    file = {"name": "../attacked.png", "sha256": "0" * 64, "media_type": "image/png", "size": 3}
    script.answers = [says(200, SUCCEEDED), *[says(200, {"items": [file]}), says(200, png(), "image/png")] * 2]
    found = client.get_job(ID)
    found.download(tmp_path / "one")

    async def by_asyncio() -> None:
        async with AsyncClient(client.url) as service:
            await AsyncJob(found.data, service).download(tmp_path / "two")

    asyncio.run(by_asyncio())
    for folder in ("one", "two"):
        assert (np.asarray(images(tmp_path / folder).attacked) == PIXELS).all()
    assert {path.name for path in tmp_path.iterdir()} == {"one", "two"}


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"state": "running"}, "is running: call wait() first"),
        ({"state": "failed", "failure": {"kind": "timeout", "detail": "3600 s"}}, "is failed: timeout: 3600 s"),
        ({"state": "rejected", "errors": [{"field": "seed", "detail": "negative"}]}, "is rejected: seed: negative"),
        ({"state": "cancelled"}, "is cancelled"),
    ],
)
def test_a_job_without_a_result_says_why(client: Client, script: Script, fields: dict[str, object], words: str) -> None:
    script.answers = [says(200, job(**fields))]
    with pytest.raises(Unfinished) as error:
        _ = client.get_job(ID).result
    assert str(error.value) == f"job {ID} {words}"


def test_rows_become_a_frame(client: Client, script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    script.answers = [says(200, SUCCEEDED)]
    rows = client.get_job(ID).subsets
    subsets = SUCCEEDED["result"]["subsets"]
    assert rows.to_frame()["perceptibility"].tolist() == [row["perceptibility"] for row in subsets]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtra, match=r'pip install "scene-attack\[pandas\]"'):
        rows.to_frame()


def test_a_job_is_queued_again_and_continued(client: Client, script: Script) -> None:
    answers = [says(200, job()), says(202, job(id="1a")), says(202, job(id="2b"))]
    script.answers = [*answers, *answers]
    found = client.get_job(ID)
    assert (found.retry().id, found.continue_().id, found.id) == ("1a", "2b", ID)

    async def run() -> tuple[str, str]:
        async with AsyncClient(client.url) as service:
            found = await service.get_job(ID)
            return (await found.retry()).id, (await found.continue_()).id

    assert asyncio.run(run()) == ("1a", "2b")
    assert script.paths == [f"GET /v1/jobs/{ID}", f"POST /v1/jobs/{ID}/retry", f"POST /v1/jobs/{ID}/continue"] * 2


@pytest.mark.parametrize(("key", "sent"), [(" sa_1_secret\n", "Bearer sa_1_secret"), ("", None)])
def test_the_key_of_the_environment_is_sent_and_follows_no_redirect(
    client: Client, script: Script, monkeypatch: pytest.MonkeyPatch, key: str, sent: str | None
) -> None:
    def elsewhere(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(307)
        handler.send_header("Location", f"{client.url}/elsewhere")
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    monkeypatch.setenv("SCENE_ATTACK_KEY", key)
    script.answers = [elsewhere, says(200, {})]
    with Client(client.url) as keyed, pytest.raises(httpx.DecodingError, match="sends on to http"):
        keyed.get_job("j")
    assert [headers.get("Authorization") for _, _, headers in script.seen] == [sent]


def test_the_key_and_the_url_may_be_given(client: Client, script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCENE_ATTACK_URL", client.url)
    monkeypatch.setenv("SCENE_ATTACK_KEY", "sa_other")
    script.answers = [says(404, NOT_FOUND)]
    with Client(key="sa_mine") as service, pytest.raises(ApiError, match="no such job"):
        service.get_job("1")
    assert script.seen[0][2]["Authorization"] == "Bearer sa_mine"
    with pytest.raises(InvalidRequest, match="no address of a service"):
        Client("localhost:8008")


CORNERS = sa.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def by_asyncio(client: Client, spec: sa.Spec) -> str:
    async def submitted() -> str:
        async with AsyncClient(client.url) as service:
            return (await service.submit(spec, priority="high")).id

    return asyncio.run(submitted())


SUBMIT: dict[str, Callable[[Client, sa.Spec], str]] = {
    "plainly": lambda client, spec: client.submit(spec, priority="high").id,
    "by asyncio": by_asyncio,
}


@pytest.mark.parametrize("submit", SUBMIT.values(), ids=SUBMIT)
@pytest.mark.parametrize("lacks", [True, False])
def test_submit_uploads_a_mesh_that_the_service_lacks(
    client: Client, script: Script, lacks: bool, submit: Callable[[Client, sa.Spec], str]
) -> None:
    uploaded = UPLOADED | {"name": str(CORNERS)}
    missing = says(404, {"detail": "there is no such upload"}, "application/problem+json")
    script.answers = [*([missing, says(201, uploaded)] if lacks else [says(200, uploaded)]), says(202, job())]
    scene = sa.Scene(objects=[sa.Object(mesh=CORNERS)])
    assert submit(client, sa.Spec(scene=scene, attack=sa.FGSM(renderer="image", steps=3))) == ID
    look = f"GET /v1/assets/{CORNERS.removeprefix('sha256:')}"
    assert script.paths == [look, *(["POST /v1/assets"] if lacks else []), "POST /v1/jobs?priority=high"]
    assert json.loads(script.bodies[-1]) == {
        "scene": {"objects": [{"mesh": str(CORNERS)}]},
        "attack": {"method": "fgsm", "renderer": "image", "steps": 3},
    }
    assert not lacks or CORNERS.bundle.data in script.bodies[1]


def test_a_campaign_s_meshes_are_uploaded_once(client: Client, script: Script) -> None:
    script.answers = [says(200, UPLOADED | {"name": str(CORNERS)}), says(202, CAMPAIGN)]
    scenes = [sa.Scene(camera=sa.Camera(azimuth=x), objects=[sa.Object(mesh=CORNERS)]) for x in (0.1, 0.2)]
    grid = sa.Grid(scenes=scenes, attacks=[{"name": "a", "attack": sa.FGSM(renderer="image", steps=3)}])
    client.submit_campaign(sa.Campaign(grids=[grid]))
    assert script.paths == [f"GET /v1/assets/{CORNERS.removeprefix('sha256:')}", "POST /v1/campaigns"]
    sent = json.loads(script.bodies[-1])["grids"][0]["scenes"]
    assert [scene["objects"] for scene in sent] == [[{"mesh": str(CORNERS)}]] * 2


def test_submit_refuses_what_only_this_process_has(client: Client, script: Script) -> None:
    network = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 3))
    scene = sa.Scene(objects=[sa.Object(mesh="primitive/cube")])
    for made in (network, sa.target(network, preprocessing={"input_size": [8, 8]})):
        with pytest.raises(sa.InvalidRequest, match=r"save it by target\.save\(folder\)") as refused:
            client.submit({"scene": scene, "target": made})
        assert refused.value.field == "target"
        with pytest.raises(ValueError, match=r"save it by target\.save\(folder\)"):
            sa.Spec(scene=scene, target=made)
    with pytest.raises(sa.InvalidRequest, match="send its scene") as refused:
        client.submit({"scene": SimpleNamespace(render=None)})
    assert refused.value.field == "scene"
    script.answers = [says(422, {"detail": "1 field is wrong", "errors": []}, "application/problem+json")]
    with pytest.raises(sa.InvalidRequest, match="there is no file") as refused:
        client.submit({"scene": {"objects": [{"mesh": "./none.obj"}]}})
    assert refused.value.field == "scene.objects.0.mesh"
