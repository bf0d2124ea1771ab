"""The real stack: embedded Redis, API and workers as processes, driven over HTTP."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import psutil
import pytest

from scene_attack.process import program
from tests.integration.specs import LASTING

if TYPE_CHECKING:
    from playwright.sync_api import Browser

TERMINAL = ("succeeded", "failed", "rejected", "cancelled")
PATIENCE = 300.0
"""Seconds; a loaded machine takes minutes for what is a matter of seconds."""


def until(look: Callable[[], Any], what: str, seconds: float = PATIENCE) -> Any:
    """The first true thing `look` returns; fails if there is none in time."""
    deadline = time.monotonic() + seconds
    while True:
        found = look()
        if found:
            return found
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.05)


@dataclass
class Stack:
    """A running `serve`."""

    process: "subprocess.Popen[str]"
    client: httpx.Client
    data: Path
    log: Path

    def submit(self, spec: dict[str, Any]) -> str:
        answer = self.client.post("/v1/jobs", json=spec)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        found: dict[str, Any] = self.client.get(f"/v1/jobs/{job_id}").json()
        return found

    def ended(self, job_id: str) -> dict[str, Any]:
        """The job once it is over."""
        found: dict[str, Any] = until(lambda: self._over(job_id), "the job ends")
        return found

    def _over(self, job_id: str) -> dict[str, Any] | None:
        job = self.job(job_id)
        return job if job["state"] in TERMINAL else None

    def attacking(self, job_id: str, step: int = 1) -> dict[str, Any]:
        """The job once it has come so far."""

        def look() -> dict[str, Any] | None:
            job = self.job(job_id)
            assert job["state"] not in TERMINAL, f"it ended too early: {job['state']} {job['failure']}"
            far = job["state"] == "running" and job["progress"] and job["progress"]["phase"] == "attacking"
            return job if far and job["progress"]["step"] >= step else None

        found: dict[str, Any] = until(look, f"step {step}")
        return found

    def checkpoint(self, job_id: str) -> None:
        """Waits until the job has a checkpoint."""
        until((self.data / "checkpoints" / job_id).exists, "a checkpoint")

    def perturbation(self, job_id: str) -> str:
        """The hash of the perturbation of a job, once it has succeeded."""
        assert self.ended(job_id)["state"] == "succeeded"
        files = self.client.get(f"/v1/jobs/{job_id}/artifacts").json()["items"]
        (sha256,) = [file["sha256"] for file in files if file["name"] == "perturbation.safetensors"]
        return str(sha256)

    def processes(self, module: str) -> list[psutil.Process]:
        """The stack's living processes that run a module."""
        found = []
        for process in psutil.Process(self.process.pid).children(recursive=True):
            try:
                if module in process.cmdline() and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
            except psutil.NoSuchProcess:
                continue
        return found

    def one(self, module: str) -> psutil.Process:
        (process,) = self.processes(module)
        return process

    def ready(self) -> None:
        def look() -> bool:
            try:
                return self.client.get("/readyz").status_code == 200
            except httpx.TransportError:
                return False

        until(look, "the service is ready")


@contextmanager
def serving(data: Path, **environ: str) -> Iterator[Stack]:
    """Start `serve` on a free port; on leaving, end it like Ctrl-C and see that nothing is left of it."""
    log = data.parent / f"{data.name}.log"
    environ = {
        "SCENE_ATTACK_DATA": str(data),
        "SCENE_ATTACK_PORT": "0",
        "SCENE_ATTACK_LEASE_SECONDS": "5",
        "SCENE_ATTACK_THREADS": "1",
        "SCENE_ATTACK_CHECK_SECONDS": "120",
        **environ,
    }
    with (
        log.open("a") as errors,
        subprocess.Popen(
            program("scene_attack", "serve"),
            env=os.environ | environ,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
        ) as process,
    ):
        # A stack that cannot start is ended, so that reading its line ends too.
        timer = threading.Timer(PATIENCE, process.kill)
        timer.start()
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith("ready http://"), log.read_text()[-5000:]
            timer.cancel()
            with httpx.Client(base_url=line.split()[1], timeout=PATIENCE) as client:
                yield Stack(process, client, data, log)
        finally:
            timer.cancel()
            end(process, signal.SIGINT)


def end(process: "subprocess.Popen[str]", number: signal.Signals) -> None:
    """Signal the supervisor and wait until its whole tree is gone."""
    if process.poll() is not None:
        return
    tree = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(number)
    process.wait(PATIENCE)
    _, alive = psutil.wait_procs(tree, timeout=PATIENCE)
    for left in alive:
        left.kill()
    assert not alive, f"left running: {[left.cmdline() for left in alive if left.is_running()]}"


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """A browser for a file: while one runs, no other event loop can in this process."""
    from tests.integration.browser import launched

    with launched() as browser:
        yield browser


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with serving(tmp_path_factory.mktemp("stack") / "data") as stack:
        yield stack


@pytest.fixture(scope="session")
def undisturbed(stack: Stack) -> str:
    """The hash of the perturbation of `LASTING` that nothing happened to."""
    return stack.perturbation(stack.submit(LASTING))
