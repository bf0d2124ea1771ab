"""The list of jobs with many of them in the record, and the page of one job that was run: the time of a page by the
clock of a client in the same process, the CPU time of both, and the bytes of the page as compressed. The database is
SQLite, its results are as long as those of real jobs. Times are medians. Writes results/job_list.json.
"""

import argparse
import json
import os
import random
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import median
from typing import Any

import httpx
import uvicorn
from sqlalchemy.orm import Session

from api.main import create_app
from benchmarks.report import RESULTS, save
from services.jobs.database import connect
from services.jobs.listed import listed, listed_outcome
from services.jobs.models import Job, State
from services.jobs.repository import Repository
from services.pipeline.outcome import outcome
from services.pipeline.result import Result
from services.pipeline.spec import parse
from services.settings import Settings
from worker.redis_server import EmbeddedRedis

PATHS = {
    "newest first": "/",
    "sorted by p": "/?sort=p",
    "a query, sorted": "/?q=scene:piano renderer:torch verified p<5e-3&sort=-queries",
    "a query of words": "/?q=piano -state:failed",
    "a query that nothing meets": "/?q=tag:none",
}
REPEATS = 15
SPEC = {"scene": {"objects": [{"mesh": "furniture/grand-piano"}]}, "attack": {"renderer": "image", "steps": 300}}
"""The attack whose page is measured."""
MESHES = ("furniture/grand-piano", "furniture/sofa", "primitive/sphere", "primitive/cube")


def main() -> None:
    """Measures; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=10_000, help="jobs in the record (default 10,000)")
    parser.add_argument("--out", type=Path, default=RESULTS / "job_list.json")
    options = parser.parse_args()
    redis = EmbeddedRedis()
    with (
        tempfile.TemporaryDirectory(prefix="scene-attack-list-") as folder,
        subprocess.Popen(redis.program().command(), stdout=subprocess.DEVNULL) as server,
    ):
        settings = Settings(data=Path(folder) / "data", redis_url=redis.url)
        try:
            with _served(settings) as client:
                fill(settings, options.jobs, rows=300)
                paths = PATHS | {"a job": f"/jobs/{_attacked(settings, Path(folder) / 'attacked')}"}
                found = {name: _measured(client, path) for name, path in paths.items()}
        finally:
            server.terminate()
        size = sum(file.stat().st_size for file in settings.data.glob("jobs.sqlite*"))
    found |= {"jobs": options.jobs, "bytes of the database": size, "cores": os.cpu_count()}
    save(options.out, __doc__ or "", f"SQLite {sqlite3.sqlite_version}", 0, **found)


@contextmanager
def _served(settings: Settings) -> Iterator[httpx.Client]:
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(create_app(settings), log_config=None, timeout_graceful_shutdown=1))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", timeout=300) as client:
            assert client.get("/healthz").status_code == httpx.codes.OK  # it waits until the app has started
            yield client
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


def _attacked(settings: Settings, folder: Path) -> str:
    """Runs an attack in a process of its own, and adds it to the record. Returns its id."""
    spec = parse(SPEC)
    command = [sys.executable, "-m", "client", "run", "-", "--out", str(folder)]
    subprocess.run(command, input=json.dumps(SPEC), text=True, stdout=subprocess.DEVNULL, check=True)
    result = json.loads((folder / "result.json").read_text("utf-8"))
    repository = Repository(connect(settings))
    job, _ = repository.create(spec, 1_000_000, None, lambda _: {})
    assert job is not None
    attempt = repository.lease(job.id, "benchmark", 600)
    assert attempt is not None
    repository.succeed(attempt, result, outcome(Result.model_validate(result)), [])
    return job.id


def _measured(client: httpx.Client, path: str) -> dict[str, float]:
    seconds, cpu, sent = [], [], 0
    for _ in range(REPEATS):
        began, used = time.perf_counter(), time.process_time()
        with client.stream("GET", path, headers={"accept-encoding": "gzip"}) as answer:
            sent = sum(map(len, answer.iter_raw()))
        seconds.append(time.perf_counter() - began)
        cpu.append(time.process_time() - used)
        assert answer.status_code == 200, path
    times = {"milliseconds": 1000 * median(seconds), "CPU milliseconds": 1000 * median(cpu)}
    return {name: round(value, 1) for name, value in (times | {"kilobytes": sent / 1000}).items()}


def fill(settings: Settings, jobs: int, rows: int = 0, seed: int = 7) -> None:
    """Adds jobs of several scenes and renderers, submitted a second apart: 85 % succeeded, 10 % failed, 5 % queued.
    Results have a trace of `rows` rows of 65 bytes.
    """
    chance = random.Random(seed)
    kinds = [
        parse({"scene": {"objects": [{"mesh": mesh}]}, "attack": {"renderer": renderer}}).model_dump(mode="json")
        for mesh in MESHES
        for renderer in ("image", "torch", "pyrender")
    ]
    result = {"trace": [{"step": step, "loss": chance.random(), "label": "grand piano"} for step in range(rows)]}
    began = datetime.now(UTC) - timedelta(seconds=jobs)
    engine = connect(settings).execution_options(writes=True)
    with Session(engine) as session, session.begin():
        for number in range(jobs):
            spec, at = kinds[number % len(kinds)], began + timedelta(seconds=number)
            ended = {} if number % 20 == 0 else _failed(at) if number % 20 < 3 else _succeeded(at, chance, result)
            about = {"state": State.QUEUED, "created_at": at, "queued_at": at, "seed": 0, "events": 1} | ended
            session.add(Job(id=f"{chance.getrandbits(128):032x}", spec=spec, **listed(spec), **about))
            if number % 500 == 0:
                session.flush()
                session.expunge_all()
    engine.dispose()


def _failed(at: datetime) -> dict[str, Any]:
    return {
        "state": State.FAILED,
        "failed_at": at,
        "ended_at": at,
        "failure_kind": "timeout",
        "failure_detail": "3600 s",
    }


def _succeeded(at: datetime, chance: random.Random, result: dict[str, Any]) -> dict[str, Any]:
    fooled = chance.random() < 0.7
    said = {
        "outcome": "fooled" if fooled else "held",
        "right_before": True,
        "fooled": fooled,
        "verified": fooled,
        "stopped": "verified",
        "before": "grand piano",
        "before_confidence": chance.random(),
        "after": "upright" if fooled else "grand piano",
        "after_confidence": chance.random(),
        "answers": [],
        "float_perceptibility": 0.01 * chance.random(),
        "perceptibility": 0.01 * chance.random(),
        "steps": chance.randrange(1, 500),
        "queries": chance.randrange(2, 50_000),
        "seconds": 100 * chance.random(),
    }
    ended = {"state": State.SUCCEEDED, "succeeded_at": at, "ended_at": at}
    return ended | {"outcome": said, "result": result, **listed_outcome(said)}


if __name__ == "__main__":
    main()
