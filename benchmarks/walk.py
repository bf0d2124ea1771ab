"""A reader's walk: the files whose functions run between the POST of a short job and its result.

Everything runs in this process, so that one tracer sees it: the API, the record, a worker with its job process, and the
engine. A first job warms the service up; the second one is traced. Functions of start-up are thus not counted, nor is
what merely declares something.

    python -m benchmarks.walk [REQUEST.json]
"""

import argparse
import json
import socket
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from contextlib import contextmanager
from inspect import CO_OPTIMIZED
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import httpx
from redis import Redis

from scene_attack.process import use
from scene_attack.runs.set_up import set_up
from scene_attack.scenes.library import Library
from scene_attack_api import warm_pool
from scene_attack_api.main import create_app, server
from scene_attack_service.jobs import warm_process
from scene_attack_service.jobs.database import connect as connect_database
from scene_attack_service.jobs.database import migrate
from scene_attack_service.jobs.files import ArtifactStore
from scene_attack_service.jobs.leases import Attempt
from scene_attack_service.jobs.queue import connect as connect_redis
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker import job_process, rq_worker
from scene_attack_worker.rq_worker import JobWorker, Runner
from scene_attack_worker.stack import EmbeddedRedis

ROOMS = {
    "API": "api/scene_attack_api/",
    "record": "services/scene_attack_service/jobs/",
    "worker": "worker/scene_attack_worker/",
    "engine: pipeline": "services/scene_attack/runs/",
    "engine: attacks": "services/scene_attack/attacks/",
}
GOAL = 25
"""Files that a reader should meet at most."""
SHORT: dict[str, Any] = {
    "scene": {"camera": {"size": [64, 64]}, "objects": [{"mesh": "primitive/sphere", "material": "plastic"}]},
    "attack": {"renderer": "torch", "method": "fgsm", "steps": 30},
}
ROOT = f"{Path(__file__).parents[1]}/"
PACKAGES = tuple(f"{ROOT}{name}/" for name in ("api", "services", "worker"))
RENDERING = ThreadPoolExecutor(1, "rendering")
"""OpenGL's context belongs to one thread."""


class Walk:
    """Traces the functions of the project's files, by file, while it is under way."""

    def __init__(self) -> None:
        self.under_way = False
        self.functions: dict[str, set[str]] = defaultdict(set)

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """The tracer, for every thread that is started from now on."""
        code = frame.f_code
        # The bodies of modules and classes are no functions.
        is_call = self.under_way and event == "call" and code.co_flags & CO_OPTIMIZED
        if is_call and code.co_filename.startswith(PACKAGES):
            self.functions[code.co_filename.removeprefix(ROOT)].add(code.co_qualname)


class LocalChild:
    """Stands for `Child`: answers as its program does, but in a thread of this process."""

    def __init__(self, module: str, settings: Settings) -> None:
        self.pid = 0
        library = Library(settings.cache_dir, settings.files)
        store = ArtifactStore(settings.files)
        jobs = job_process.Jobs(settings)
        ready = {"ready": 0, "abilities": job_process.abilities(settings).record()}
        self._answer: Future[dict[str, Any]] | None = RENDERING.submit(lambda: ready)

        def answer(message: dict[str, Any]) -> dict[str, Any]:
            if module == warm_pool.PROGRAM:
                return warm_process.answer(message, library, store)
            return job_process.answer(jobs, Attempt(message["job"], message["attempt"]))

        self._program = answer

    def alive(self) -> bool:
        """It runs as long as this process."""
        return True

    def memory(self) -> int:
        """Its memory is this process's."""
        return 0

    def idle_seconds(self) -> float:
        """It does not hang, or this program would."""
        return 0.0

    def send(self, message: dict[str, Any]) -> None:
        """Begins to answer."""
        self._answer = RENDERING.submit(self._program, message)

    def receive(self, seconds: float) -> dict[str, Any] | None:
        """The answer, or None if there is none within `seconds`."""
        assert self._answer is not None
        try:
            return self._answer.result(seconds)
        except NotYet:
            return None

    def end(self) -> None:
        """There is nothing to end."""

    def kill(self) -> int:
        """There is nothing to kill."""
        return 0


@contextmanager
def service(folder: Path) -> Iterator[tuple[Settings, httpx.Client]]:
    """The API at a free port, with a Redis of its own; its settings, and a client of it."""
    redis = EmbeddedRedis()
    try:
        with subprocess.Popen(list(redis.program().command()), stdout=subprocess.DEVNULL) as program:
            settings = Settings(data=folder, redis_url=redis.url)
            use(settings)
            set_up(settings)
            while not redis.answers():
                pass
            engine = connect_database(settings)
            migrate(engine, settings)
            engine.dispose()
            listener = socket.create_server(("127.0.0.1", 0))
            uvicorn = server(create_app(settings))
            thread = threading.Thread(target=uvicorn.run, kwargs={"sockets": [listener]})
            thread.start()
            try:
                with httpx.Client(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", timeout=300) as client:
                    client.get("/healthz").raise_for_status()
                    yield settings, client
            finally:
                uvicorn.should_exit = True
                thread.join()
                program.terminate()
    finally:
        redis.remove()


def finish(runner: Runner, redis: Redis, client: httpx.Client, request: dict[str, Any]) -> dict[str, Any]:
    """Posts a job, lets a worker run it, and gets it with its result."""
    job_id = client.post("/v1/jobs", json=request).raise_for_status().json()["id"]
    JobWorker(runner, name=f"walk-{job_id}", connection=redis).work(burst=True, logging_level="WARNING")
    job: dict[str, Any] = client.get(f"/v1/jobs/{job_id}").raise_for_status().json()
    return job


def main() -> int:
    """Prints the files by room, and whether there are at most GOAL. Returns the exit status: 1 if the job failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("request", nargs="?", type=Path, help="a request as JSON (default: a sphere, 30 steps of FGSM)")
    path = parser.parse_args().request
    request = SHORT if path is None else json.loads(path.read_text())
    walk = Walk()
    threading.setprofile(walk)
    sys.setprofile(walk)
    warm_pool.Child = rq_worker.Child = LocalChild  # type: ignore[assignment, misc]
    with TemporaryDirectory() as folder, service(Path(folder) / "data") as (settings, client):
        runner = Runner(settings, Record(connect_database(settings)), "walk")
        redis = connect_redis(settings.redis_url)
        finish(runner, redis, client, request)
        walk.under_way = True
        job = finish(runner, redis, client, request | {"seed": 1})
        walk.under_way = False
    if job["state"] != "succeeded":
        print(f"the job has {job['state']}: {job.get('failure')}")
        return 1
    total = 0
    for room, folder in ROOMS.items():
        files = sorted(file for file in walk.functions if file.startswith(folder))
        total += len(files)
        print(f"\n{room}: {len(files)}")
        for file in files:
            names = sorted(name for name in walk.functions[file] if "<" not in name)
            print(f"  {file}: {len(names)} functions, such as {', '.join(names[:3])}")
    others = len(walk.functions) - total
    print(f"\n{total} files of these rooms (goal: at most {GOAL}), and {others} of the rooms that they call")
    return 0


if __name__ == "__main__":
    sys.exit(main())
