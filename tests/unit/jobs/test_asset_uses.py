"""What the record says of uploaded meshes in jobs and campaigns that were there before it did."""

import json
from typing import Any

import pytest
from sqlalchemy import Engine, select, text
from sqlalchemy.orm import Session

from services.jobs.asset_models import CampaignAsset, JobAsset
from services.jobs.database import connect, migrate
from services.jobs.repository import Repository
from services.pipeline.spec import parse
from services.settings import Settings
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import add
from tests.unit.jobs.test_listed import before

FIRST, SECOND = f"sha256:{'0a' * 32}", f"sha256:{'0b' * 32}"
SCENE: dict[str, Any] = {"objects": [{"mesh": FIRST}, {"mesh": "primitive/sphere"}, {"mesh": FIRST}]}


def test_a_job_refers_to_the_uploads_of_its_scene_and_not_to_its_words(engine: Engine, clock: Clock) -> None:
    job = add(Repository(engine, clock), parse({"scene": SCENE}))
    add(Repository(engine, clock), parse({"scene": {"objects": [{"mesh": "primitive/sphere"}]}}))
    with Session(engine) as session:
        assert session.execute(select(JobAsset.job_id, JobAsset.name)).all() == [(job.id, FIRST)]


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_the_migration_finds_the_uploads_of_what_is_there(
    kind: str, tmp_path: Any, request: pytest.FixtureRequest
) -> None:
    settings = Settings(data=tmp_path)
    if kind == "postgresql":
        server = request.getfixturevalue("postgresql_server")
        settings = Settings(data=tmp_path, database_url=server.url(server.create()))
    (tmp_path / "jobs.sqlite").touch()
    engine = connect(settings)
    before(engine, "0013")
    grids = [{"scenes": {"meshes": [FIRST, "primitive/cube"]}}, {"scenes": [{"objects": [{"mesh": SECOND}]}]}]
    with engine.begin() as connection:
        for one, spec in (("a", {"scene": SCENE}), ("b", {"scene": {"objects": [{"mesh": "x", "material": FIRST}]}})):
            connection.execute(
                text(
                    "INSERT INTO jobs (id, state, spec, seed, created_at, attempt, lost, events) VALUES"
                    " (:id, 'queued', :spec, 1, '2030-01-01 00:00:00', 0, 0, 0)"
                ),
                {"id": one, "spec": json.dumps(spec)},
            )
        connection.execute(
            text(
                "INSERT INTO campaigns (id, name, state, spec, created_at, view_count, request_digest) VALUES"
                " ('c', 'c', 'running', :spec, '2030-01-01 00:00:00', 1, '00')"
            ),
            {"spec": json.dumps({"grids": grids, "jobs": [{"scene": SCENE}]})},
        )
    migrate(engine, settings)
    with Session(engine) as session:
        assert session.execute(select(JobAsset.job_id, JobAsset.name)).all() == [("a", FIRST)]
        assert set(session.scalars(select(CampaignAsset.name))) == {FIRST, SECOND}
    engine.dispose()
