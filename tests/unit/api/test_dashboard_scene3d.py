"""The part of a job's page that shows its scene in three dimensions."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.jobs.models import Artifact, Job
from services.jobs.record import Record
from services.pipeline.result import Result, outcome
from services.pipeline.spec import JobSpec, parse
from tests.unit.api.dashboard_records import SPEC, add, open_record, result, start
from tests.unit.api.test_dashboard_pages import Tags, get

pytestmark = [pytest.mark.slow, pytest.mark.anyio]
MOVED = parse({"scene": {"objects": [{"mesh": "furniture/grand-piano"}]}, "attack": {"renderer": "pyrender"}})


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    with open_record(tmp_path) as made:
        yield made


def ended(record: Record, spec: JobSpec, *names: str) -> Job:
    """A job of this spec that ended with these files."""
    job = add(record, spec)
    found = result(spec)
    files = [Artifact(job_id=job.id, name=name, sha256="ab" * 32, media_type="x/y", size=1) for name in names]
    assert record.leases.succeed(start(record, job), found, outcome(Result.model_validate(found)), files)
    return job


@pytest.mark.parametrize(("spec", "sides"), [(SPEC, ["before"]), (MOVED, ["before", "after"])])
async def test_a_job_has_its_scene_and_links_to_it(record: Record, spec: JobSpec, sides: list[str]) -> None:
    job = ended(record, spec, "perturbation.safetensors", "result.json")
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    files = {side: f"/v1/jobs/{job.id}/scene.glb?which={side}" for side in sides}
    (view,) = tags.all("scene-3d")
    assert {name.removeprefix("data-"): value for name, value in view.items() if value and "glb" in value} == files
    assert [link["href"] for link in tags.all("a") if "scene.glb" in (link["href"] or "")] == list(files.values())
    assert not any("open" in part for part in tags.all("details"))


async def test_a_job_that_stored_no_perturbation_has_a_sentence(record: Record) -> None:
    job = ended(record, MOVED, "original.png")
    page = await get(record, f"/jobs/{job.id}")
    assert "stored no perturbation" in Tags(page.text).text
    assert "scene.glb" not in page.text


async def test_a_job_whose_result_is_no_file_asks_for_no_scene(record: Record) -> None:
    job = ended(record, MOVED, "perturbation.safetensors")
    page = await get(record, f"/jobs/{job.id}")
    assert "stored no result as a file" in Tags(page.text).text
    assert "scene.glb" not in page.text


@pytest.mark.parametrize(
    ("background", "said"), [({}, "the environment map, is not in this view"), ({"image": "AAAA"}, "a picture, is not")]
)
async def test_a_background_that_the_view_has_not_is_said(
    record: Record, background: dict[str, str], said: str
) -> None:
    scene = {"objects": [{"mesh": "furniture/grand-piano"}]}
    for behind, is_said in ((background, True), (None, False)):
        spec = parse({"scene": scene | {"background": behind}, "attack": {"renderer": "pyrender"}})
        job = ended(record, spec, "perturbation.safetensors", "result.json")
        assert (said in Tags((await get(record, f"/jobs/{job.id}")).text).text) == is_said


async def test_a_job_without_a_result_has_no_scene(record: Record) -> None:
    job = add(record, MOVED)
    assert "scene3d-details" not in (await get(record, f"/jobs/{job.id}")).text
