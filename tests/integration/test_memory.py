"""What a job may have of the machine's memory, with targets that take it in each of the ways in which it is counted."""

from collections.abc import Iterator

import pytest

from tests.integration.conftest import Stack, serving
from tests.integration.specs import QUICK
from tests.integration.test_extensions import FILES, write

pytestmark = pytest.mark.integration

LIMIT = 2 * 2**30
SAID = "more memory than SCENE_ATTACK_JOB_MEMORY_BYTES allows a process, 2 GiB"
TARGETS = (
    FILES["brightest_channel.py"]
    + '''
import mmap
import sys

HELD = []
"""What the targets of this process have taken."""


def reserve():  # as PyTorch's CUDA build does: addresses at which nothing can be read or written
    HELD.append(mmap.mmap(-1, 64 * 2**30, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, prot=0))


def torch_block():
    import torch

    HELD.append(torch.empty(64 * 2**30, dtype=torch.uint8))


def numpy_block():
    import numpy

    HELD.append(numpy.empty(64 * 2**30, numpy.uint8))


def pieces():
    import torch

    [torch.ones(2**27, dtype=torch.uint8) for _ in range(32)]


def private_map():
    HELD.append(mmap.mmap(-1, 64 * 2**30, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS))


def shared_map():
    HELD.append(mmap.mmap(-1, 4 * 2**30))
    for start in range(0, 4 * 2**30, 2**26):
        HELD[-1][start : start + 2**26] = bytes(2**26)


def target(name, take, process):
    @register(CARD.model_copy(update={"name": name}), lambda: LABELS)
    def load_after_taking(dtype):
        if process in sys.orig_argv:
            take()
        return load(dtype)


for take in (reserve, torch_block, numpy_block, pieces, private_map, shared_map):
    target("job-" + take.__name__, take, "worker.job_process")
for take in (torch_block, shared_map):
    target("check-" + take.__name__, take, "services.jobs.warm_process")
'''
)


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack of 2 GiB a process, with targets that take memory when they are loaded."""
    folder = write(tmp_path_factory.mktemp("extensions"), {"takes_memory.py": TARGETS})
    environ = {"SCENE_ATTACK_EXTENSIONS": str(folder), "SCENE_ATTACK_JOB_MEMORY_BYTES": str(LIMIT)}
    with serving(tmp_path_factory.mktemp("limited") / "data", **environ) as stack:
        yield stack


def test_addresses_that_are_not_used_cost_a_job_nothing(limited: Stack) -> None:
    process = limited.one("worker.job_process")
    job = limited.ended(limited.submit(QUICK | {"target": {"name": "job-reserve"}}))
    assert job["state"] == "succeeded", job["failure"]
    assert process.memory_info().vms > 64 * 2**30


@pytest.mark.parametrize("way", ["torch_block", "numpy_block", "pieces", "private_map", "shared_map"])
def test_a_job_that_takes_too_much_ends_and_names_the_setting(limited: Stack, way: str) -> None:
    job = limited.ended(limited.submit(QUICK | {"target": {"name": f"job-{way}"}}))
    assert job["failure"] == {"kind": "out-of-memory", "detail": f"the job needed {SAID}"}
    after = limited.ended(limited.submit(QUICK | {"target": {"name": "brightest-channel"}}))
    assert after["state"] == "succeeded", after["failure"]


@pytest.mark.parametrize("way", ["torch_block", "shared_map"])
def test_a_request_that_takes_too_much_is_refused_before_it_is_a_job(limited: Stack, way: str) -> None:
    answer = limited.client.post("/v1/jobs", json=QUICK | {"target": {"name": f"check-{way}"}})
    assert answer.status_code == 422
    detail = f"rendering it once takes {SAID}; ask for a smaller image, a smaller environment map or fewer objects"
    assert answer.json()["errors"] == [{"field": "scene", "detail": detail}]
