"""The client against a server on a real socket that answers what each test scripts."""

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from client import api_client, async_client
from client.api_client import ApiClient, ApiError
from client.cli import app
from services.pipeline.spec import parse

pytestmark = pytest.mark.slow

Answer = Callable[[BaseHTTPRequestHandler], None]


class Script:
    """Answers, one for each request in turn, and the requests that came, with their bodies."""

    def __init__(self) -> None:
        self.answers: list[Answer] = []
        self.seen: list[tuple[str, str, dict[str, str]]] = []
        self.bodies: list[bytes] = []


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Script:
    # Client and server are one process: if the machine pauses it, the clients' clocks go on, and a request would end.
    for module in (api_client, async_client):
        monkeypatch.setattr(module, "PATIENCE", None)
    return Script()


@pytest.fixture
def client(script: Script) -> Iterator[ApiClient]:
    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            script.bodies.append(self.rfile.read(int(self.headers.get("Content-Length", 0))))
            script.seen.append((self.command, self.path, dict(self.headers)))
            script.answers.pop(0)(self)

        do_GET = do_POST = do_PATCH = do_DELETE = answer  # noqa: N815

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    with ApiClient(f"http://127.0.0.1:{server.server_port}/") as made:
        yield made
    server.shutdown()
    thread.join()
    server.server_close()


def says(status: int, body: object, kind: str = "application/json") -> Answer:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        handler.send_response(status)
        handler.send_header("Content-Type", kind)
        handler.send_header("Content-Length", str(len(data)))
        handler.end_headers()
        handler.wfile.write(data)

    return answer


def streams(*events: tuple[int, str, dict[str, object]], drop: bool = False) -> Answer:
    """Events; then the stream ends, or the connection breaks in the middle of one."""

    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", "text/event-stream")
        text = "".join(f"id: {n}\nevent: {kind}\ndata: {json.dumps(data)}\n\n" for n, kind, data in events)
        if drop:
            handler.send_header("Content-Length", "100000")
            text += "id: 99\nevent: state\ndata: {"
        handler.end_headers()
        handler.wfile.write(text.encode())

    return answer


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(api_client, "sleep", lambda _: None)


RUNNING = (1, "state", {"state": "running"})
DONE = (3, "state", {"state": "succeeded"})


def progress(number: int) -> tuple[int, str, dict[str, object]]:
    return number, "progress", {"phase": "attacking", "step": number, "steps": 9, "rows": []}


def test_a_dropped_stream_is_taken_up_after_the_last_event(client: ApiClient, script: Script) -> None:
    script.answers = [streams(RUNNING, progress(2), drop=True), streams(DONE)]
    assert [event.number for event in client.stream_job_events("j")] == ["1", "2", "3"]
    assert "Last-Event-ID" not in script.seen[0][2]
    assert script.seen[1][2]["Last-Event-ID"] == "2"


def test_a_stream_that_ends_before_the_job_is_taken_up_too(client: ApiClient, script: Script) -> None:
    script.answers = [streams(RUNNING), streams(progress(2)), streams(DONE)]
    assert [event.kind for event in client.stream_job_events("j")] == ["state", "progress", "state"]
    assert [headers.get("Last-Event-ID") for _, _, headers in script.seen] == [None, "1", "2"]


def test_signs_of_life_are_not_events(client: ApiClient, script: Script) -> None:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", "text/event-stream")
        handler.end_headers()
        handler.wfile.write(b'id: 1\nevent: state\ndata: {"state": "running"}\n\n: ping\n\n: ping\n\n')

    script.answers = [answer, streams(DONE)]
    assert [event.number for event in client.stream_job_events("j")] == ["1", "3"]


def test_nothing_left_to_hear_is_the_end(client: ApiClient, script: Script) -> None:
    script.answers = [lambda handler: (handler.send_response(204), handler.end_headers())[0]]
    assert list(client.stream_job_events("j", after="3")) == []


def test_a_stream_that_never_gets_anywhere_is_given_up(client: ApiClient, script: Script) -> None:
    script.answers = [streams(drop=True)] * 30
    with pytest.raises(httpx.TransportError):
        list(client.stream_job_events("j"))
    assert len(script.seen) == 9


def test_an_unknown_job_is_refused_at_once(client: ApiClient, script: Script) -> None:
    script.answers = [says(404, {"status": 404, "title": "Not Found", "detail": "there is no such job"})]
    with pytest.raises(ApiError, match="there is no such job") as refused:
        list(client.stream_job_events("j"))
    assert refused.value.status == 404


def test_a_refusal_names_every_bad_field(client: ApiClient, script: Script) -> None:
    problem = {
        "status": 422,
        "detail": "…",
        "errors": [{"field": "scene.objects.0.mesh", "detail": "no"}, {"field": "seed", "detail": "negative"}],
    }
    script.answers = [says(422, problem, "application/problem+json")]
    with pytest.raises(ApiError) as refused:
        client.submit_job({})
    assert str(refused.value) == "scene.objects.0.mesh: no; seed: negative"
    assert refused.value.problem == problem


def test_an_error_that_is_no_problem_document_is_still_an_error(client: ApiClient, script: Script) -> None:
    script.answers = [says(502, b"<html>bad gateway", "text/html")]
    with pytest.raises(ApiError, match="HTTP 502"):
        client.get_job("j")


def test_a_download_that_breaks_leaves_no_file(client: ApiClient, script: Script, tmp_path: Path) -> None:
    def broken(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Length", "1000")
        handler.end_headers()
        handler.wfile.write(b"half")

    script.answers = [broken, says(200, b"whole", "image/png")]
    with pytest.raises(httpx.TransportError):
        client.download_artifact("j", "attacked.png", tmp_path / "attacked.png")
    assert not (tmp_path / "attacked.png").exists()
    client.download_artifact("j", "attacked.png", tmp_path / "attacked.png")
    assert (tmp_path / "attacked.png").read_bytes() == b"whole"
    assert [path.name for path in tmp_path.iterdir()] == ["attacked.png"]


def test_an_upload_is_deleted_by_its_name(client: ApiClient, script: Script) -> None:
    script.answers = [says(204, b""), says(409, {"detail": "the mesh is in use by job 0f3c"})]
    client.delete_asset("sha256:" + "0a" * 32)
    with pytest.raises(ApiError, match="in use by job 0f3c"):
        client.delete_asset("0a" * 32)
    assert [(method, path) for method, path, _ in script.seen] == [("DELETE", "/v1/assets/" + "0a" * 32)] * 2


def test_a_priority_is_sent_if_one_is_given(client: ApiClient, script: Script) -> None:
    script.answers += [says(202, {"id": "1"})] * 4
    client.submit_job({}, "high")
    client.submit_job({})
    client.submit_campaign({}, "normal")
    command = ["submit", "-", "--priority", "low", "--url", client.url]
    done = CliRunner().invoke(app, command, input='{"scene": {}}')
    assert done.exit_code == 0, done.output
    paths = ["/v1/jobs?priority=high", "/v1/jobs", "/v1/campaigns?priority=normal", "/v1/jobs?priority=low"]
    assert [path for _, path, _ in script.seen] == paths


def test_a_priority_of_another_name_is_refused(client: ApiClient, script: Script) -> None:
    done = CliRunner().invoke(app, ["submit", "-", "--priority", "urgent", "--url", client.url], input="{}")
    assert done.exit_code == 2
    assert script.seen == []


def test_a_job_that_no_worker_can_run_says_why(client: ApiClient, script: Script) -> None:
    why = "no worker that is running has the device cuda"
    spec = parse({"scene": {"objects": [{"mesh": "primitive/cube"}]}}).model_dump(mode="json")
    job = {"id": "1", "state": "queued", "name": "cube", "attack": "a", "target": "t", "waiting": why, "spec": spec}
    script.answers += [says(200, {"items": [job, job | {"waiting": None}], "next": None}), says(200, job)]
    listed = CliRunner().invoke(app, ["jobs", "list", "--url", client.url], env={"COLUMNS": "200"})
    assert listed.output.count(why) == 1
    shown = CliRunner().invoke(app, ["jobs", "show", "1" * 32, "--url", client.url], env={"COLUMNS": "200"})
    assert f"waits: {why}" in shown.output


def test_a_job_is_shown_as_people_call_it(client: ApiClient, script: Script) -> None:
    spec = parse({"scene": {"objects": [{"mesh": f"sha256:{'0' * 64}"}]}}).model_dump(mode="json")
    job = {"id": "1", "state": "failed", "name": "vase", "attack": "a", "spec": spec}
    script.answers += [says(200, job), says(200, job | {"title": "Figure 3", "tags": ["paper"], "note": "Look twice."})]
    plain, named = (
        CliRunner().invoke(app, ["jobs", "show", "1" * 32, "--url", client.url], env={"COLUMNS": "200"}).output
        for _ in range(2)
    )
    assert "vase" in plain
    assert "sha256" not in plain
    assert all(text in named for text in ("Figure 3", "tags: paper", "note: Look twice."))


def test_nobody_there_is_not_ready() -> None:
    with ApiClient("http://127.0.0.1:1") as nobody:
        assert not nobody.ready()


@pytest.mark.parametrize(("key", "sent"), [(" sa_1_secret\n", "Bearer sa_1_secret"), ("", None)])
def test_the_key_of_the_environment_is_sent_and_follows_no_redirect(
    script: Script, client: ApiClient, monkeypatch: pytest.MonkeyPatch, key: str, sent: str | None
) -> None:
    def elsewhere(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(307)
        handler.send_header("Location", f"{client.url}/elsewhere")
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    monkeypatch.setenv("SCENE_ATTACK_KEY", key)
    script.answers = [elsewhere, says(200, {})]
    with ApiClient(client.url) as keyed, pytest.raises(httpx.DecodingError, match="sends on to http"):
        keyed.get_job("j")
    assert [headers.get("Authorization") for _, _, headers in script.seen] == [sent]
