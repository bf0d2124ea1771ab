"""Uploads of owners: their deletion, and what happens to what refers to them at the same moment."""

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import Engine, event

from scene_attack.blobs import blobs
from scene_attack.errors import InUse, InvalidRequest
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.campaign_spec import parse as parse_campaign
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.scenes.library import Library
from scene_attack_service.access.caller import KEYLESS, Caller, OwnedAssets, Scope
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.models import Job
from scene_attack_service.jobs.record import Record
from scene_attack_service.jobs.uploads import REQUEST_SECONDS, DeletedAssets
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import attacks

pytestmark = pytest.mark.slow

ALICE, BOB = Caller("alice", frozenset(), "sa_1"), Caller("bob", frozenset(), "sa_2")
ROOT = Caller("root", frozenset({Scope.ADMIN}), "sa_3")
MESH = "sha256:" + "0a" * 32
TETRAHEDRON = b"OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


def job_with(mesh: str) -> JobSpec:
    return parse({"scene": {"objects": [{"mesh": "primitive/sphere"}, {"mesh": mesh}]}})


def campaign_with(mesh: str) -> CampaignSpec:
    attacks = [{"name": "a", "attack": {"method": "fgsm"}}]
    return parse_campaign({"grids": [{"scenes": {"meshes": ["primitive/sphere", mesh]}, "attacks": attacks}]})


def add_job(engine: Engine, owner: str, mesh: str = MESH) -> Job:
    job, _ = Record(engine).jobs.create(job_with(mesh), 1000, None, lambda _: {}, owner=owner)
    assert job is not None
    return job


def test_an_owner_deletes_its_own_upload_and_gets_its_quota_back(assets: OwnedAssets) -> None:
    for owner in ("alice", "bob"):
        assets.add(owner, MESH, 60)
    assert assets.delete(ALICE, MESH)
    assert [assets.used(owner) for owner in ("alice", "bob")] == [0, 60]
    assert [assets.visible(caller)(MESH) for caller in (ALICE, BOB, ROOT)] == [False, True, True]
    assert not assets.delete(ALICE, MESH)
    assert assets.delete(BOB, MESH)
    assert not assets.visible(ROOT)(MESH)
    assert not assets.delete(ROOT, MESH)
    assets.add("bob", MESH, 60)
    assert [assets.visible(caller)(MESH) for caller in (ALICE, BOB, ROOT)] == [False, True, True]


@pytest.mark.parametrize("caller", [ROOT, KEYLESS])
def test_an_administrator_deletes_the_uploads_of_all(assets: OwnedAssets, caller: Caller) -> None:
    for owner in ("alice", "bob"):
        assets.add(owner, MESH, 60)
    assert assets.delete(caller, MESH)
    assert assets.used("alice") == assets.used("bob") == 0
    assert not assets.visible(caller)(MESH)


def test_a_mesh_is_not_deleted_while_a_job_refers_to_it(assets: OwnedAssets, engine: Engine) -> None:
    assets.add("alice", MESH, 60)
    job = add_job(engine, "alice")
    Record(engine).jobs.request_cancel(job.id)
    for caller in (ALICE, ROOT):
        with pytest.raises(InUse, match=job.id):
            assets.delete(caller, MESH)
    assert assets.used("alice") == 60
    Record(engine).jobs.delete(job.id)
    assert assets.delete(ALICE, MESH)


def test_a_mesh_is_not_deleted_while_a_campaign_refers_to_it(assets: OwnedAssets, engine: Engine) -> None:
    assets.add("alice", MESH, 60)
    campaign = Record(engine).campaigns.submit(campaign_with(MESH), None, "alice")
    with pytest.raises(InUse, match=campaign.id):
        assets.delete(ALICE, MESH)


def test_jobs_of_others_count_once_no_owner_is_left_and_are_not_named(assets: OwnedAssets, engine: Engine) -> None:
    for owner in ("alice", "bob"):
        assets.add(owner, MESH, 60)
    job = add_job(engine, "root")
    assert assets.delete(ALICE, MESH)
    with pytest.raises(InUse) as error:
        assets.delete(BOB, MESH)
    assert "another owner" in str(error.value)
    assert job.id not in str(error.value)


def test_a_deleted_mesh_is_refused_by_the_name_of_its_field(assets: OwnedAssets, engine: Engine) -> None:
    assets.add("alice", MESH, 60)
    assert assets.delete(ALICE, MESH)
    with pytest.raises(InvalidRequest, match="any more") as error:
        add_job(engine, "alice")
    assert error.value.field == "scene.objects.1.mesh"
    with pytest.raises(InvalidRequest, match="any more") as error:
        Record(engine).campaigns.submit(campaign_with(MESH), None, "alice")
    assert error.value.field == "grids.0.scenes.meshes.1"
    lit = parse({"scene": {"objects": [{"mesh": "primitive/sphere"}], "lights": {"environment": {"map": MESH}}}})
    with pytest.raises(InvalidRequest) as error:
        Record(engine).jobs.create(lit, 1000, None, lambda _: {}, owner="alice")
    assert error.value.field == "scene.lights.environment.map"
    assert attacks(Record(engine)) == []
    assert Record(engine).campaigns.page(None, 9, None) == []


def test_lists_show_the_name_that_an_upload_was_given(assets: OwnedAssets, engine: Engine) -> None:
    assert assets.add("alice", MESH, 60, "Chair")
    before = add_job(engine, "alice")
    assert before.scene == "sphere, Chair"
    assert not assets.add("alice", MESH, 60)
    record = Record(engine)
    attempt = record.leases.lease(before.id, "worker", 20)
    assert attempt is not None
    record.leases.checked(attempt, job_with(MESH).model_dump(mode="json"), "00", ())
    line = record.jobs.line(before.id)
    assert line is not None
    assert (line.name, line.scene) == ("sphere, Chair", "sphere, Chair")
    other = f"sha256:{'0b' * 32}"
    assert add_job(engine, "alice", other).scene == "sphere, sha256:0b0b0b0"


def test_of_a_job_and_a_deletion_at_once_one_is_refused(assets: OwnedAssets, engine: Engine) -> None:
    for number in range(12):
        mesh = f"sha256:{number:064x}"
        assets.add("alice", mesh, 60)
        together = threading.Barrier(2)

        def submit(mesh: str = mesh, together: threading.Barrier = together) -> bool:
            together.wait()
            try:
                add_job(engine, "alice", mesh)
            except InvalidRequest:
                return False
            return True

        def delete(mesh: str = mesh, together: threading.Barrier = together) -> bool:
            together.wait()
            try:
                return assets.delete(ALICE, mesh)
            except InUse:
                return False

        with ThreadPoolExecutor(2) as pool:
            asked = [pool.submit(submit), pool.submit(delete)]
            assert sorted(one.result() for one in asked) == [False, True]


@pytest.mark.parametrize("comes", ["job", "deletion"])
def test_whichever_comes_second_sees_the_first(assets: OwnedAssets, engine: Engine, comes: str) -> None:
    """One of the two is made to begin while the other's transaction is open and has changed nothing but its hold."""
    assets.add("alice", MESH, 60)
    second: list[threading.Thread] = []
    refused: list[Exception] = []

    def other() -> None:
        try:
            add_job(engine, "alice") if comes == "job" else assets.delete(ALICE, MESH)
        except (InUse, InvalidRequest) as error:
            refused.append(error)

    def begin_second(*_: object) -> None:
        if not second:
            second.append(threading.Thread(target=other))
            second[0].start()

    statement = "UPDATE assets" if comes == "job" else "INSERT INTO job_assets"

    def watch(_connection: object, _cursor: object, said: str, *_: object) -> None:
        if said.startswith(statement):
            begin_second()

    event.listen(engine, "before_cursor_execute", watch)
    if comes == "job":
        assert assets.delete(ALICE, MESH)
    else:
        add_job(engine, "alice")
    second[0].join()
    assert [type(error) for error in refused] == [InvalidRequest if comes == "job" else InUse]


def refuse(assets: OwnedAssets) -> None:
    assert assets.used("alice") == 60
    raise InvalidRequest("file", "it is no mesh")


def test_an_upload_that_fails_is_no_upload(assets: OwnedAssets) -> None:
    for known in (False, True):
        if known:
            assets.add("alice", MESH, 60)
        with pytest.raises(InvalidRequest), assets.adding("alice", MESH, 60):
            refuse(assets)
        assert assets.used("alice") == (60 if known else 0)


@pytest.fixture(params=["folder", "S3"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    return tmp_path / "data" if request.param == "folder" else str(request.getfixturevalue("s3_url"))


def test_the_files_go_when_no_owner_is_left(
    assets: OwnedAssets, engine: Engine, clock: Clock, place: Path | str, tmp_path: Path
) -> None:
    library = Library(tmp_path / "cache", place)
    name = library.add_mesh(TETRAHEDRON, "off").name
    library.mesh(name)
    removal = DeletedAssets(Database(engine, clock), library)
    for owner in ("alice", "bob"):
        assets.add(owner, name, 60)
    for caller, is_left in ((ALICE, True), (BOB, False)):
        assert assets.delete(caller, name)
        removal.remove(name)
        assert library.has_upload(name) == is_left
    assert blobs(place, "assets").names() == []
    assert list((tmp_path / "cache" / "meshes").glob("*.npz")) == []
    with pytest.raises(InvalidRequest):
        library.check_mesh(name)  # though it was in memory
    with assets.adding("alice", name, 60):
        library.add_mesh(TETRAHEDRON, "off")
    removal.remove_all()
    assert library.has_upload(name)


def test_files_that_were_left_are_removed_later_and_the_deletion_is_forgotten(
    assets: OwnedAssets, engine: Engine, clock: Clock, tmp_path: Path
) -> None:
    library = Library(tmp_path / "cache", tmp_path / "data")
    name = library.add_mesh(TETRAHEDRON, "off").name
    removal = DeletedAssets(Database(engine, clock), library)
    assets.add("alice", name, 60)
    assert assets.delete(ALICE, name)  # and the process dies
    removal.remove_all()
    assert not library.has_upload(name)
    assert not assets.visible(ROOT)(name)
    clock.advance(REQUEST_SECONDS + 1)
    removal.remove_all()
    assert assets.visible(ROOT)(name)
