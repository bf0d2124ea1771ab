"""The pages of a campaign that has run, from a real record."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from httpx import ASGITransport

from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.queue import Queue
from scene_attack_service.jobs.queue import connect as connect_redis
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.unit.api.dashboard_records import Tags, app
from tests.unit.jobs.campaign_stage import Stage, spec

pytestmark = [pytest.mark.slow, pytest.mark.anyio]


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    settings = Settings(data=tmp_path)
    engine = connect(settings)
    migrate(engine, settings)
    yield Stage(engine, Record(engine))
    engine.dispose()


async def get(stage: Stage, path: str) -> Tags:
    redis = Queue(connect_redis("redis://127.0.0.1:1"))  # out of reach, which pages survive
    made = app(stage.record, redis)
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
    assert len(page.all("svg")) == 3  # against queries, seconds and p
    assert page.text.count("attacked") >= 3
    assert {one["href"] for one in page.all("a") if one["href"]} >= {
        f"/v1/campaigns/{campaign}/table.{kind}" for kind in ("json", "csv", "tex")
    }
    assert not [one for one in page.all("form") if one["method"] == "post"]  # nothing to pause or cancel any more
    assert "data-poll" not in {key for one in page.all("div") for key in one}
    listed = await get(stage, "/campaigns")
    assert "finished" in listed.text
    assert "3/3" in listed.text


async def test_a_campaign_that_attacks_nothing_says_why(stage: Stage) -> None:
    sphere, attacks = {"meshes": ["primitive/sphere"], "views": [0]}, [{"name": "a", "attack": {"renderer": "torch"}}]
    campaign = stage.begin(spec(grids=[{"scenes": sphere, "attacks": attacks, "selection": {"least_confidence": 0.9}}]))
    stage.finish(campaign)
    page = await get(stage, f"/campaigns/{campaign}")
    assert "No view is attacked: the network is less sure than 0.9 (1 of 1)." in page.text


async def test_a_campaign_in_the_middle_shows_its_progress_and_is_reloaded(stage: Stage) -> None:
    campaign = stage.begin(spec(3))
    stage.selected(campaign)
    stage.feeder.tick()
    stage.work(stage.queued()[0])
    stage.feeder.tick()
    page = await get(stage, f"/campaigns/{campaign}")
    assert "1 of 3 jobs ended" in page.text
    assert "left" in page.text
    assert {one.get("action") for one in page.all("form") if one["method"] == "post"} == {
        f"/campaigns/{campaign}/pause",
        f"/campaigns/{campaign}/cancel",
    }
    assert any("data-poll" in one for one in page.all("div"))


async def test_the_heat_map_opens_a_cell_and_says_what_mattered(stage: Stage) -> None:
    campaign = stage.begin(spec(3))
    stage.finish(campaign)
    page = await get(stage, f"/campaigns/{campaign}?rows=azimuth&columns=target&measure=queries")
    squares = [one["href"] or "" for one in page.all("a") if "#opened" in (one["href"] or "")]
    assert len(squares) == 2  # azimuths of 0°, 0.6° and 1.1°
    assert "1,234 1/1" in page.text
    assert page.text.count("by azimuth and target") == 1
    opened = await get(stage, squares[1].partition("#")[0])
    assert "1°, efficientnet-lite0: 2 cases" in opened.text
    assert len([one for one in opened.all("a") if one.get("aria-current") == "true"]) == 1
    # Of the three jobs, the same attribution: normals moved the log-odds by -2.25
    assert "normals -2.250 ± 0.000" in page.text
    assert "Best cases" in page.text
    # an unknown choice is the default one
    assert "by scene and attack" in (await get(stage, f"/campaigns/{campaign}?rows=nonsense&measure=x")).text


async def test_every_curve_has_a_table(stage: Stage) -> None:
    campaign = stage.begin(spec(3))
    stage.finish(campaign)
    page = await get(stage, f"/campaigns/{campaign}")
    assert "normals queries 1234 3 100.0 %" in page.text
    assert "normals seconds 1.25 3 100.0 %" in page.text
    assert "normals p ×10⁻³ 11.7 3 100.0 %" in page.text


async def test_campaigns_side_by_side(stage: Stage) -> None:
    first, second = stage.begin(spec(3)), stage.begin(spec(2, seed=5, name="d"))
    for campaign in (first, second):
        stage.finish(campaign)
    ticks = {one["value"] for one in (await get(stage, "/campaigns")).all("input") if one["name"] == "campaign"}
    assert ticks == {first, second}
    page = await get(stage, f"/compare/campaigns?campaign={first}&campaign={second}&against=p")
    # Wilson's intervals of 3 in 3 and 2 in 2
    assert "normals against efficientnet-lite0 100.0 % 3 of 3; 43.9 % – 100.0 %" in page.text
    assert "100.0 % 2 of 2; 34.2 % – 100.0 %" in page.text
    assert "grids.0.seeds 0 5" in page.text
    assert len(page.all("svg")) == 1
    assert len([one for one in page.all("path") if "curve" in (one["class"] or "")]) == 2
    corners = "normals efficientnet-lite0 A"
    assert corners in page.text
    assert corners.replace("A", "B") in page.text


async def test_a_campaign_without_cases_has_a_dash_beside_one_with_them(stage: Stage) -> None:
    first = stage.begin(spec(1))
    stage.finish(first)
    second = stage.begin(spec(1, seed=5))
    stage.selected(second)
    page = await get(stage, f"/compare/campaigns?campaigns={first},{second}")
    assert "normals against efficientnet-lite0 100.0 % 1 of 1" in page.text
    assert "–" in page.text.partition("1 of 1")[2].partition("What differs")[0].rpartition("10⁻³")[2]


async def test_the_table_has_what_adversaries_survive(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three of them before cameras, and before two renderers; campaigns without have no such columns."""
    held = {"variations": 64, "right": 50, "fooled": 40, "share": 0.8, "interval": [0.67, 0.887]}
    seen = {"label": "a", "confidence": 0.5}
    opinion = {"before": seen, "after": seen, "right_before": True}
    analyses = {
        "survival": held | {"wrong_share": 0.22, "wrong_interval": [0.13, 0.33]},
        "second_opinion": [
            opinion | {"renderer": "tracer", "outcome": "fooled"},
            opinion | {"renderer": "raster", "outcome": "held"},
            {"renderer": "broken", "failure": "it was killed"},
        ],
    }
    plain = stage.begin(spec(3))
    stage.finish(plain)
    own = Stage.result
    monkeypatch.setattr(Stage, "result", staticmethod(lambda job: own(job, analyses=analyses)))
    campaign = stage.begin(spec(3).model_copy(update={"reuse": False}))
    stage.finish(campaign)
    page = await get(stage, f"/campaigns/{campaign}")
    assert "Survival before cameras" in page.text
    assert "80.0 % (28.8 % – 97.5 %)" in page.text
    assert "Survive in raster" in page.text
    assert "3 of 3 (43.9 % – 100.0 %)" in page.text
    assert "0 of 3 (0.0 % – 56.1 %)" in page.text
    assert "broken" not in page.text
    assert "Survive in" not in (await get(stage, f"/campaigns/{plain}")).text
