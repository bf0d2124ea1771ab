"""Which uploaded meshes jobs refer to."""

from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from services.jobs.models import JobAsset
from services.jobs.record import Record
from services.pipeline.spec import parse
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import add

FIRST = f"sha256:{'0a' * 32}"
SCENE: dict[str, Any] = {"objects": [{"mesh": FIRST}, {"mesh": "primitive/sphere"}, {"mesh": FIRST}]}


def test_a_job_refers_to_the_uploads_of_its_scene_and_not_to_its_words(engine: Engine, clock: Clock) -> None:
    job = add(Record(engine, clock), parse({"scene": SCENE}))
    add(Record(engine, clock), parse({"scene": {"objects": [{"mesh": "primitive/sphere"}]}}))
    with Session(engine) as session:
        assert session.execute(select(JobAsset.job_id, JobAsset.name)).all() == [(job.id, FIRST)]
