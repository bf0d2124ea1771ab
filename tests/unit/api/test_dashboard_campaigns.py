"""The pages of a campaign that has run, from a real record."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from httpx import ASGITransport

from services.jobs.campaign_service import CampaignService
from services.jobs.database import connect, migrate
from services.jobs.queue import Queue
from services.jobs.queue import connect as connect_redis
from services.jobs.repository import Repository
from services.settings import Settings
from tests.unit.api.dashboard_records import app
from tests.unit.api.test_dashboard_pages import Tags
from tests.unit.jobs.campaign_stage import Stage, spec

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    settings = Settings(data=tmp_path)
    engine = connect(settings)
    migrate(engine, settings)
    yield Stage(engine, Repository(engine))
    engine.dispose()


async def get(stage: Stage, path: str) -> Tags:
    redis = Queue(connect_redis("redis://127.0.0.1:1"))  # out of reach, which pages survive
    made = app(stage.repository, CampaignService(stage.campaigns, redis))
    async with httpx.AsyncClient(transport=ASGITransport(made), base_url="http://dashboard") as client:
        answer = await client.get(path)
    assert answer.status_code == 200, answer.text
    return Tags(answer.text)


async def test_a_finished_campaign_shows_its_table_curves_and_views(stage: Stage) -> None:
    campaign = stage.begin(spec(3))
    stage.finish(campaign)
    page = await get(stage, f"/campaigns/{campaign}")
    assert "3 of 3 jobs ended" in page.text
    assert "3 fooled." in page.text
    # Wilson's interval of 3 in 3
    assert "100.0 % 43.9 % – 100.0 %" in page.text
    assert "normals, efficientnet-lite0: verified successes, % of 3" in page.text
    assert len(page.all("svg")) == 2  # against queries and against seconds
    assert page.text.count("attacked") >= 3
    assert {one["href"] for one in page.all("a") if one["href"]} >= {
        f"/v1/campaigns/{campaign}/table.{kind}" for kind in ("json", "csv", "tex")
    }
    assert not page.all("form")  # nothing to pause or cancel any more
    assert "data-poll" not in {key for one in page.all("div") for key in one}
    listed = await get(stage, "/campaigns")
    assert "finished" in listed.text
    assert "3/3" in listed.text


async def test_a_campaign_in_the_middle_shows_its_progress_and_is_reloaded(stage: Stage) -> None:
    campaign = stage.begin(spec(3))
    stage.selected(campaign)
    stage.feeder.tick()
    stage.work(stage.queued()[0])
    stage.feeder.tick()
    page = await get(stage, f"/campaigns/{campaign}")
    assert "1 of 3 jobs ended" in page.text
    assert "left" in page.text
    assert {one.get("action") for one in page.all("form")} == {
        f"/campaigns/{campaign}/pause",
        f"/campaigns/{campaign}/cancel",
    }
    assert any("data-poll" in one for one in page.all("div"))
