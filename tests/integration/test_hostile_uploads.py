"""Hostile uploads to the running service: each gets its answer, and the service is afterwards what it was before."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
import pytest

from tests.integration.conftest import Stack, until
from tests.integration.hostile_files import IMAGES, hostile, in_base64
from tests.unit.scenes.mesh_files import BOXES

GROWTH = 200 * 2**20
"""Largest growth of the resident memory of all the service's processes, bytes."""
PRIVATE = (os.getcwd(), sys.prefix, "/tmp", "/root", "/home", "/usr", "site-packages", "Traceback", ".py")
"""What no answer may hold."""
SMALL = {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [32, 32]}}
READER = "scene_attack.scenes.reading.process"


def memory(stack: Stack) -> int:
    """Resident memory of the service, bytes; what processes share is counted for each."""
    total = 0
    for process in [psutil.Process(stack.process.pid), *psutil.Process(stack.process.pid).children(recursive=True)]:
        try:
            total += process.memory_info().rss
        except psutil.NoSuchProcess:
            continue
    return total


def upload(stack: Stack, data: bytes, kind: str) -> httpx.Response:
    return stack.client.post("/v1/assets", files={"file": ("mesh", data)}, data={"kind": kind})


def is_traced(process: psutil.Process) -> bool:
    return "TracerPid:\t0\n" not in Path(f"/proc/{process.pid}/status").read_text()


@contextmanager
def programs_started(processes: list[psutil.Process], log: Path) -> Iterator[list[str]]:
    """Fills a list with the system calls by which the processes and their children start programs meanwhile."""
    pids = [word for process in processes for word in ("-p", str(process.pid))]
    with subprocess.Popen(["strace", "-f", "-qq", "-e", "trace=execve,execveat", "-o", str(log), *pids]) as strace:
        started: list[str] = []
        try:
            until(lambda: all(map(is_traced, processes)), "strace traces the service")
            yield started
        finally:
            strace.terminate()
    started += [line for line in log.read_text().splitlines() if "exec" in line]


def refusal(answer: httpx.Response) -> Any:
    """The fields that an answer refuses, or else its status; what is private in it, if anything is."""
    found = [word for word in PRIVATE if word in answer.text]
    if found:
        return f"it holds {found}: {answer.text[:500]}"
    if answer.status_code == 422:
        assert answer.headers["content-type"] == "application/problem+json"
        return sorted({error["field"] for error in answer.json()["errors"]})
    return answer.status_code


@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace; scripts/setup --test installs it")
def test_hostile_meshes_are_refused_and_leave_the_service_as_it_was(stack: Stack, tmp_path: Path) -> None:
    assert upload(stack, BOXES["stl"], "stl").status_code == 201
    before, api = memory(stack), stack.one("scene_attack_api.main")
    # Other processes of the service may have readers of their own, and a reader has children for a moment.
    (reader,) = [process for process in stack.processes(READER) if process.ppid() == api.pid]
    processes = [api, reader]
    wrong: dict[str, Any] = {}
    with programs_started(processes, tmp_path / "strace.log") as started:
        count = 0
        for name, (kind, data, field) in hostile():
            count += 1
            said = refusal(upload(stack, data, kind))
            if said != (201 if field is None else [field]):
                wrong[name] = said
    assert wrong == {}
    assert count >= 150
    assert started == []
    assert all(process.is_running() for process in processes)
    assert upload(stack, BOXES["off"], "off").status_code == 201
    assert stack.client.get("/readyz").status_code == 200
    assert memory(stack) < before + GROWTH


def long_triangles(count: int) -> bytes:
    """An obj of triangles between random places of a sphere: of 2,000 a shape makes seven million."""
    places = np.random.default_rng(0).normal(size=(3 * count, 3))
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in places / np.linalg.norm(places, axis=1, keepdims=True)]
    return "\n".join(lines + [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(count)]).encode()


def test_a_mesh_that_cannot_be_divided_is_refused_where_it_would_be_bent(stack: Stack) -> None:
    """Its triangles would take gigabytes; only in the first step, long after the request was accepted."""
    mesh = upload(stack, long_triangles(2_000), "obj").json()["name"]
    spec = {"scene": SMALL | {"objects": [{"mesh": mesh}]}, "attack": {"renderer": "torch", "groups": ["shape"]}}
    answer = stack.client.post("/v1/jobs", json=spec)
    if answer.status_code == 202:
        stack.client.post(f"/v1/jobs/{answer.json()['id']}/cancel")
    assert refusal(answer) == ["scene.objects.0.mesh"]


def test_hostile_images_are_refused_and_leave_the_service_as_it_was(stack: Stack) -> None:
    def said(data: bytes) -> Any:
        body = {"image": {"data": in_base64(data)}, "scene": SMALL, "fit": {"steps": 1}}
        return refusal(stack.client.post("/v1/rerenderings", json=body))

    said(b"starts the process")
    before = memory(stack)
    assert {name: said(data) for name, data in IMAGES.items()} == {name: ["image"] for name in IMAGES}
    assert stack.client.get("/readyz").status_code == 200
    assert memory(stack) < before + GROWTH
