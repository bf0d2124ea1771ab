"""The Python clients against the real stack."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from scene_attack import ApiError, AsyncClient, Client
from scene_attack.client import operations
from tests.integration.conftest import Stack
from tests.integration.specs import ENDLESS, QUICK

pytestmark = pytest.mark.integration


def test_a_program_runs_a_job_and_reads_its_images(stack: Stack, tmp_path: Path) -> None:
    with Client(str(stack.client.base_url)) as service:
        job = service.submit(QUICK).wait()
        assert job.state == "succeeded", job.failure
        assert job.trace.to_frame()["step"].is_monotonic_increasing
        assert sorted(job.subsets[-1].groups) == sorted(job.result.change.group_perceptibility)
        size = tuple(reversed(QUICK["scene"]["camera"]["size"]))
        assert job.images.original.size == job.images.attacked.size == size
        assert (np.asarray(job.images.original) != np.asarray(job.images.attacked)).any()
        assert {path.name for path in job.download(tmp_path)} == set(job.files())
        assert job.id in {found.id for found in service.list_jobs(state="succeeded")}
        assert service.call(operations.get_readiness()).ready
        with pytest.raises(ApiError, match=r"scene\.objects\.0\.mesh.*attack\.steps|attack\.steps.*mesh"):
            service.submit({"scene": {"objects": [{"mesh": 3}]}, "attack": {"steps": -1}})
        job.delete()
        with pytest.raises(ApiError, match="no such job"):
            job.refresh()


def test_asyncio_follows_several_jobs_at_once(stack: Stack) -> None:
    async def run() -> tuple[str, str]:
        async with AsyncClient(str(stack.client.base_url)) as service:
            quick = await service.submit(QUICK)  # first: a worker takes them in the order of their checks
            endless = await service.submit(ENDLESS)
            waited = asyncio.create_task(endless.wait())
            await quick.wait()
            await endless.cancel()
            await waited
            return quick.state, endless.state

    assert asyncio.run(run()) == ("succeeded", "cancelled")
