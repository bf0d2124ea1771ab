"""Which uploaded meshes jobs refer to, and what the record knows of a mesh, on both databases."""

from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from scene_attack.runs.result import Result, outcome
from scene_attack.runs.spec import parse
from scene_attack_service.access.caller import OwnedAssets
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.models import JobAsset
from scene_attack_service.jobs.record import Record
from scene_attack_service.jobs.uploads import AssetRecords, FirstAnswer
from tests.unit.api.dashboard_records import SPEC, result
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import add

LITE = "efficientnet-lite0"


def ended(record: Record, *meshes: str, label: str = "grand piano", **changed: Any) -> str:
    """A job on these meshes that ran to its end; the network called the original image `label`."""
    scene = {"objects": [{"mesh": mesh} for mesh in meshes]}
    spec = parse({"scene": scene, "attack": {"renderer": "torch"}, "goal": {"leave": "grand piano"}})
    job, _ = record.jobs.create(spec, 99, None, lambda _: {}, owner=changed.pop("owner", ""))
    assert job is not None
    attempt = record.leases.lease(job.id, "test", 60)
    assert attempt is not None
    found = result(**changed)
    found["original"]["label"] = label
    record.leases.succeed(attempt, found, outcome(Result.model_validate(found)), [])
    return job.id


def test_answers_are_those_to_scenes_of_the_mesh_alone(record: Record, engine: Engine) -> None:
    ended(record, "primitive/cone")
    ended(record, "primitive/cone")
    ended(record, "primitive/cone", label="lampshade", right_before=None)
    ended(record, "furniture/cone", label="traffic cone")  # the same short name
    ended(record, "primitive/cone", "primitive/cube", label="crate")
    ended(record, "primitive/cone", label="bell", owner="other")
    record.jobs.create(SPEC, 99, None, lambda _: {})  # not ended
    records = AssetRecords(Database(engine))
    found = records.first_answers(["primitive/cone", "primitive/cube", "furniture/cone"], "")
    assert found == {
        "primitive/cone": [FirstAnswer(LITE, "grand piano", True, 2), FirstAnswer(LITE, "lampshade", None, 1)],
        "furniture/cone": [FirstAnswer(LITE, "traffic cone", True, 1)],
    }
    assert {one.label for one in records.first_answers(["primitive/cone"], None)["primitive/cone"]} >= {"bell"}


def test_the_jobs_on_a_mesh_are_listed_newest_first(record: Record, engine: Engine, clock: Any) -> None:
    ids = []
    for _ in range(3):
        ids.append(ended(record, "primitive/cone"))
        clock.advance(1)
    ended(record, "furniture/cone")
    found = AssetRecords(Database(engine)).jobs("primitive/cone", 2, "")
    assert [job.id for job in found] == ids[:0:-1]
    assert found[0].spec["scene"]["objects"][0]["mesh"] == "primitive/cone"


def test_jobs_on_an_upload_are_found_by_its_title_and_from_before_it_had_one(record: Record, engine: Engine) -> None:
    upload = f"sha256:{'0a' * 32}"
    ids = {ended(record, upload)}
    OwnedAssets(engine).add("", upload, 60, "Chair")
    ids.add(ended(record, upload))
    records = AssetRecords(Database(engine))
    assert {job.id for job in records.jobs(upload, 9, "")} == ids
    assert records.first_answers([upload], "") == {upload: [FirstAnswer(LITE, "grand piano", True, 2)]}


FIRST = f"sha256:{'0a' * 32}"
SCENE: dict[str, Any] = {"objects": [{"mesh": FIRST}, {"mesh": "primitive/sphere"}, {"mesh": FIRST}]}


def test_a_job_refers_to_the_uploads_of_its_scene_and_not_to_its_words(engine: Engine, clock: Clock) -> None:
    job = add(Record(engine, clock), parse({"scene": SCENE}))
    add(Record(engine, clock), parse({"scene": {"objects": [{"mesh": "primitive/sphere"}]}}))
    with Session(engine) as session:
        assert session.execute(select(JobAsset.job_id, JobAsset.name)).all() == [(job.id, FIRST)]
