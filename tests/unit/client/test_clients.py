"""`Client` and `AsyncClient` against a server on a real socket that answers what each test scripts."""

import asyncio
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

import client as package
from client import ApiError, AsyncClient, Client, Unfinished, async_client, images, operations
from client.api_client import ApiClient
from services.errors import InvalidRequest
from tests.unit.client.test_api_client import DONE, RUNNING, Script, client, progress, says, script, streams

pytestmark = pytest.mark.slow

__all__ = ["client", "script"]  # fixtures

SUBSETS = [{"groups": ["light"], "perceptibility": 0.25}, {"groups": ["light", "pose"], "perceptibility": 0.5}]
JOB: dict[str, Any] = {
    "id": "0f3c", "state": "running", "name": "cube", "attack": "fgsm", "spec": {}, "outcome": None, "failure": None,
    "result": None,
}  # fmt: skip
SUCCEEDED = JOB | {"state": "succeeded", "result": {"verified": True, "subsets": SUBSETS, "trace": [{"step": 0}]}}
PIXELS = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)


def png() -> bytes:
    file = io.BytesIO()
    PIL.Image.fromarray(PIXELS).save(file, "PNG")
    return file.getvalue()


def test_a_job_is_submitted_watched_and_read(client: ApiClient, script: Script) -> None:
    script.answers = [
        says(202, JOB), streams(RUNNING, progress(2), drop=True), streams(DONE), says(200, SUCCEEDED),
        says(200, png(), "image/png"),
    ]  # fmt: skip
    with Client(client.url) as service:
        job = service.submit_job({"scene": {}}, priority="high").wait()
        assert job.verified
        assert job.subsets == SUBSETS
        assert job.trace == [{"step": 0}]
        assert (np.asarray(job.images.attacked) == PIXELS).all()
        assert job.images.attacked is job.images.attacked  # it is read once
    assert [f"{method} {path}" for method, path, _ in script.seen] == [
        "POST /v1/jobs?priority=high", "GET /v1/jobs/0f3c/events", "GET /v1/jobs/0f3c/events", "GET /v1/jobs/0f3c",
        "GET /v1/jobs/0f3c/artifacts/attacked.png",
    ]  # fmt: skip


def test_the_same_by_asyncio(client: ApiClient, script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    script.answers = [
        says(202, JOB), streams(RUNNING, progress(2), drop=True), streams(DONE), says(200, SUCCEEDED),
        *[says(200, png(), "image/png")] * 2,
    ]  # fmt: skip
    paused: list[float] = []

    async def pause(seconds: float) -> None:
        paused.append(seconds)

    monkeypatch.setattr(async_client, "sleep", pause)

    async def run() -> None:
        async with AsyncClient(client.url) as service:
            job = await (await service.submit_job({"scene": {}})).wait()
            assert job.subsets == SUBSETS
            for _ in range(2):
                assert (np.asarray(await job.images.attacked) == PIXELS).all()

    asyncio.run(run())
    assert [headers.get("last-event-id") or headers.get("Last-Event-ID") for _, _, headers in script.seen[1:3]] == [
        None,
        "2",
    ]
    assert len(paused) == 1


def test_a_stream_that_never_gets_anywhere_is_given_up_by_asyncio_too(
    client: ApiClient, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    script.answers = [says(202, JOB), *[streams()] * 30]

    async def at_once(_: float) -> None:
        pass

    monkeypatch.setattr(async_client, "sleep", at_once)

    async def run() -> None:
        async with AsyncClient(client.url) as service:
            await (await service.submit_job({})).wait()

    with pytest.raises(async_client.httpx.TransportError, match="keeps ending"):
        asyncio.run(run())
    assert len(script.seen) == 1 + 9


def test_all_pages_of_a_list_are_read(client: ApiClient, script: Script) -> None:
    page = [says(200, {"items": [{"id": "1"}], "next": "c"}), says(200, {"items": [{"id": "2"}], "next": None})]
    script.answers = page * 2

    async def by_asyncio() -> list[str]:
        async with AsyncClient(client.url) as service:
            return [job["id"] async for job in service.list_jobs(state="failed")]

    with Client(client.url) as service:
        assert [job["id"] for job in service.list_jobs(state="failed")] == ["1", "2"]
    assert asyncio.run(by_asyncio()) == ["1", "2"]
    assert [path for _, path, _ in script.seen] == ["/v1/jobs?state=failed", "/v1/jobs?state=failed&cursor=c"] * 2


def test_every_operation_can_be_called(client: ApiClient, script: Script) -> None:
    script.answers = [says(200, {"items": []}), says(200, b"a,b\n", "text/csv"), says(204, b"")]
    with Client(client.url) as service:
        assert service.call(operations.list_targets())["items"] == []
        assert service.call(operations.get_campaign_table_csv("1")) == "a,b\n"
        service.call(operations.delete_asset("sha256:1"))


def test_files_are_written_into_the_folder_whatever_their_names(
    client: ApiClient, script: Script, tmp_path: Path
) -> None:
    named = {"items": [{"name": "../attacked.png"}]}
    script.answers = [says(200, SUCCEEDED), *[says(200, named), says(200, png(), "image/png")] * 2]

    async def by_asyncio() -> None:
        async with AsyncClient(client.url) as service:
            await async_client.AsyncJob(SUCCEEDED, service).download(tmp_path / "two")  # type: ignore[arg-type]

    with Client(client.url) as service:
        service.get_job("0f3c").download(tmp_path / "one")
    asyncio.run(by_asyncio())
    for folder in ("one", "two"):
        assert (np.asarray(images(tmp_path / folder).attacked) == PIXELS).all()
    assert {path.name for path in tmp_path.iterdir()} == {"one", "two"}


@pytest.mark.parametrize(
    ("state", "failure", "said"),
    [
        ("running", None, "job 0f3c is running: call wait() first"),
        ("failed", {"kind": "timeout", "detail": "over 3600 s"}, "job 0f3c is failed: timeout: over 3600 s"),
        ("cancelled", None, "job 0f3c is cancelled"),
    ],
)
def test_a_job_without_a_result_says_why(
    client: ApiClient, script: Script, state: str, failure: dict[str, str] | None, said: str
) -> None:
    script.answers = [says(200, JOB | {"state": state, "failure": failure})]
    with Client(client.url) as service, pytest.raises(Unfinished) as error:
        _ = service.get_job("0f3c").result
    assert str(error.value) == said


def test_rows_become_a_frame(client: ApiClient, script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    script.answers = [says(200, SUCCEEDED)]
    with Client(client.url) as service:
        rows = service.get_job("0f3c").subsets
    frame = rows.to_frame()
    assert list(frame.columns) == ["groups", "perceptibility"]
    assert frame["perceptibility"].sum() == 0.75
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'scene-attack\[pandas\]'"):
        rows.to_frame()


def test_the_key_and_the_url_may_be_given(client: ApiClient, script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCENE_ATTACK_URL", client.url)
    monkeypatch.setenv("SCENE_ATTACK_KEY", "sa_other")
    script.answers = [says(404, {"detail": "there is no such job"})]
    with Client(key="sa_mine") as service, pytest.raises(ApiError, match="no such job"):
        service.get_job("1")
    assert script.seen[0][2]["Authorization"] == "Bearer sa_mine"
    with pytest.raises(InvalidRequest, match="no address of a service"):
        Client("localhost:8008")


def test_the_package_names_what_it_has() -> None:
    assert all(getattr(package, name) is not None for name in package.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = package.nothing


def test_a_job_is_queued_again_and_continued(client: ApiClient, script: Script) -> None:
    answers = [says(200, JOB), says(202, JOB | {"id": "1a"}), says(202, JOB | {"id": "2b"})]
    script.answers = [*answers, *answers]
    with Client(client.url) as service:
        job = service.get_job("0f3c")
        assert (job.retry().id, job.continue_().id, job.id) == ("1a", "2b", "0f3c")

    async def run() -> tuple[str, str]:
        async with AsyncClient(client.url) as service:
            job = await service.get_job("0f3c")
            return (await job.retry()).id, (await job.continue_()).id

    assert asyncio.run(run()) == ("1a", "2b")
    paths = ["/v1/jobs/0f3c", "/v1/jobs/0f3c/retry", "/v1/jobs/0f3c/continue"]
    assert [path for _, path, _ in script.seen] == [*paths, *paths]
