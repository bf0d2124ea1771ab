"""The program that sends messages to webhooks, with a record and a receiver on this machine."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from queue import SimpleQueue

import pytest
from sqlalchemy import Engine

from services.jobs.database import connect, migrate
from services.jobs.repository import Repository
from services.jobs.webhooks import Webhooks
from services.settings import Settings
from tests.unit.jobs.records import SPEC, add, start
from worker.deliveries import AT_ONCE, PER_OWNER, Sender

LONG = 60


@pytest.fixture
def values(tmp_path: Path) -> Settings:
    return Settings.model_validate({"data": tmp_path, "webhook_hosts": "127.0.0.1"})


@pytest.fixture
def engine(values: Settings) -> Iterator[Engine]:
    engine = connect(values)
    migrate(engine, values)
    yield engine
    engine.dispose()


@pytest.fixture
def receiver() -> Iterator[tuple[str, SimpleQueue[dict[str, object]]]]:
    """An address, and what is told to it. The first message is answered by 503."""
    got: SimpleQueue[dict[str, object]] = SimpleQueue()
    statuses = iter([503])

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            got.put(json.loads(self.rfile.read(int(self.headers["content-length"]))))
            self.send_response(next(statuses, 200))
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Receiver) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/", got
        server.shutdown()
        thread.join()


def test_messages_of_ended_jobs_are_sent(
    values: Settings, engine: Engine, receiver: tuple[str, SimpleQueue[dict[str, object]]]
) -> None:
    url, got = receiver
    webhooks, repository = Webhooks(engine), Repository(engine)
    hook = webhooks.create("", url)
    command = [sys.executable, "-m", "worker.deliveries"]
    program = subprocess.Popen(command, env=os.environ | values.environ())
    try:
        for kind in ("timeout", "internal"):
            repository.fail(start(repository, add(repository)), kind, "")
            told = got.get(timeout=LONG)
            assert (told["type"], told["data"]["failure"]["kind"]) == ("job.failed", kind)  # type: ignore[index]
    finally:
        program.send_signal(signal.SIGTERM)
        assert program.wait(LONG) == 0
    second, first = webhooks.deliveries(hook.id)
    assert (first.attempts, first.status, first.error, first.delivered_at) == (1, 503, "it answered 503", None)
    assert first.due_at is not None
    assert (second.attempts, second.status, second.due_at) == (1, 200, None)


def test_a_receiver_that_never_answers_delays_its_owner_only(
    values: Settings, engine: Engine, receiver: tuple[str, SimpleQueue[dict[str, object]]]
) -> None:
    url, got = receiver
    webhooks, repository = Webhooks(engine), Repository(engine)
    with socket.create_server(("127.0.0.1", 0), backlog=AT_ONCE) as silent, ThreadPoolExecutor(AT_ONCE) as pool:
        for owner, address in (("one", f"http://127.0.0.1:{silent.getsockname()[1]}/"), ("another", url)):
            webhooks.create(owner, address)
            for _ in range(AT_ONCE if owner == "one" else 1):
                job, _ = repository.create(SPEC, 99, None, lambda _: {}, owner=owner)
                assert job is not None
                repository.request_cancel(job.id)
        sender = Sender(webhooks, values, pool)
        sender.round()
        assert got.get(timeout=LONG)["type"] == "job.cancelled"
        asked = [silent.accept()[0] for _ in range(PER_OWNER)]
        sender.round()
        assert not sender.idle()
        silent.setblocking(False)
        with pytest.raises(BlockingIOError):
            silent.accept()
        for one in asked:
            one.close()
