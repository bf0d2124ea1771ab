"""Jobs that an earlier version ran, on the pages."""

import json
from pathlib import Path

import pytest

from services.jobs.repository import Repository
from services.pipeline.outcome import outcome as line_of
from services.pipeline.result import Result
from tests.unit.api.dashboard_records import add, result, start
from tests.unit.api.test_dashboard_pages import Tags, anyio_backend, get, repository

__all__ = ["anyio_backend", "repository"]
pytestmark = pytest.mark.anyio


async def test_a_result_of_version_0_1_0_has_its_page(repository: Repository) -> None:
    """The file is what that version wrote; fields that came later are missing in it."""
    found = json.loads((Path(__file__).parent / "result-0.1.0.json").read_text())
    job = add(repository)
    attempt = start(repository, job)
    assert repository.succeed(attempt, found, line_of(Result.model_validate(result())), [])
    page = await get(repository, f"/jobs/{job.id}")
    assert page.status_code == 200
    assert "necklace" in Tags(page.text).text
