"""The page of the jobs and the page that compares jobs, rendered from a real record."""

import httpx
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.runs.spec import RerenderingSpec, parse
from scene_attack_api.dashboard.comparison import differences
from scene_attack_service.jobs.record import Record
from tests.unit.api.dashboard_records import SPEC, Tags, add, result, send, start, succeed

pytestmark = [pytest.mark.slow, pytest.mark.anyio]
HOSTILE = '"><script>alert(1)</script>'


def rows(page: httpx.Response) -> list[str]:
    found = Tags(page.text).all("tr")
    return [row["data-id"] or "" for row in found if row.get("data-id") not in (None, "head")]


async def test_the_strip_and_the_totals(record: Record) -> None:
    succeed(record, add(record), result())
    start(record, add(record))
    add(record)
    add(record, parse({"scene": {"objects": [{"mesh": "primitive/cube"}]}}))
    text = Tags((await send(record, "/?q=scene:piano")).text).text
    assert "Running 1 Queued 2 Time left about 3.8 s Fooled, verified 1 of 1" in text
    assert "3 jobs that meet the query; fooled and verified 1 of 1; 1,234 queries; 1.2 s of run time" in text


async def test_a_re_rendering_has_no_outcome_and_is_in_no_rate(record: Record) -> None:
    fit = {"image": "ab" * 32, "scene": SPEC.scene, "target": SPEC.target, "fit": {"steps": 1}}
    job, _ = record.jobs.create(RerenderingSpec.model_validate(fit), 1000, None, lambda _: {})
    assert job is not None
    assert record.leases.succeed(start(record, job), {"rerendering": {}}, {}, [])
    page = await send(record, "/?q=kind:rerendering")
    assert rows(page) == [job.id]
    assert "fooled and verified 0 of 0" in Tags(page.text).text


async def test_a_query_that_cannot_be_read_says_where(record: Record) -> None:
    add(record)
    page = await send(record, "/?q=rendrer:torch")
    assert page.status_code == 422
    assert "at character 1: there is no field 'rendrer'" in Tags(page.text).text
    assert rows(page) == []


async def test_headings_sort_both_ways(record: Record) -> None:
    low, high = add(record), add(record)
    for job, p in ((high, 0.02), (low, 0.01)):
        succeed(record, job, result(float_perceptibility=p))
    page = await send(record, "/")
    assert "/?sort=p" in {a["href"] for a in Tags(page.text).all("a")}
    page = await send(record, "/?sort=p")
    assert rows(page) == [low.id, high.id]
    assert "/?sort=-p" in {a["href"] for a in Tags(page.text).all("a")}
    assert [th.get("aria-sort") for th in Tags(page.text).all("th") if th.get("aria-sort")] == ["ascending"]
    assert rows(await send(record, "/?sort=-p")) == [high.id, low.id]


async def test_what_people_write_is_text(record: Record) -> None:
    job = add(record)
    record.lists.edit(job.id, {"title": HOSTILE, "tags": ["<b>"]})
    page = await send(record, "/?q=" + "%22%3E%3Cscript%3E%22")
    assert "<script>alert" not in page.text
    page = await send(record, "/")
    assert "<script>alert" not in page.text
    assert HOSTILE in Tags(page.text).text


async def test_ticked_jobs_are_cancelled_and_tagged(record: Record) -> None:
    first, second = add(record), add(record)
    done = await send(record, "/jobs/selected", {"job": first.id, "action": "cancel", "q": "state:queued", "sort": "p"})
    assert (done.status_code, done.headers["location"]) == (303, "/?q=state%3Aqueued&sort=p")
    assert rows(await send(record, done.headers["location"])) == [second.id]
    await send(record, "/jobs/selected", {"job": second.id, "action": "tag", "tag": "mine"})
    assert rows(await send(record, "/?q=tag:mine")) == [second.id]
    refused = await send(record, "/jobs/selected", {"job": "unknown", "action": "cancel"})
    assert "there is no such job" in Tags(refused.text).text
    refused = await send(record, "/jobs/selected", {"job": second.id, "action": "tag", "tag": "a b"})
    assert "a tag has 1 to 50 characters" in Tags(refused.text).text
    assert "no job is ticked" in Tags((await send(record, "/jobs/selected", {"action": "cancel"})).text).text


@pytest.mark.parametrize("tag", ["a\0", "\x1b[31m", "\x9b31m"])
async def test_a_tag_has_no_control_characters(record: Record, tag: str) -> None:
    job = add(record)
    refused = await send(record, "/jobs/selected", {"job": job.id, "action": "tag", "tag": tag})
    assert "a tag has 1 to 50 characters" in Tags(refused.text).text
    found = record.jobs.get(job.id)
    assert found is not None
    assert not found.tags


async def test_a_new_tag_takes_the_place_of_none(record: Record) -> None:
    job, tags = add(record), [f"t{number:02}" for number in range(20)]
    record.lists.edit(job.id, {"tags": tags})
    for tag, status in (("t05", 303), ("z", 200)):
        done = await send(record, "/jobs/selected", {"job": job.id, "action": "tag", "tag": tag})
        assert done.status_code == status
        found = record.jobs.get(job.id)
        assert found is not None
        assert found.tags == tags
    assert "it has 20 tags already" in Tags(done.text).text


async def test_a_comparison_shows_what_differs_and_both_curves(record: Record) -> None:
    one, other = add(record), add(record, SPEC.model_copy(update={"seed": 8}))
    succeed(record, one, result())
    succeed(record, other, result(float_perceptibility=0.02))
    page = await send(record, f"/compare?jobs={one.id},{other.id}")
    tags = Tags(page.text)
    assert "Field A grand-piano B grand-piano seed 7 8" in tags.text
    assert len(tags.all("svg")) == 4
    assert len([path for path in tags.all("path") if "curve" in (path["class"] or "")]) == 8
    assert len(tags.all("img")) - 1 == 6
    by_form = await send(record, f"/compare?job={one.id}&job={other.id}&q=&sort=p&against=step")
    assert by_form.status_code == 200
    with pytest.raises(InvalidRequest, match="jobs: name 2 to 8 jobs"):
        await send(record, f"/compare?jobs={one.id}")
    assert (await send(record, f"/compare?jobs={one.id},unknown")).status_code == 404


async def test_differences_are_by_field() -> None:
    first = {"a": {"b": 1, "c": [1, 2]}, "d": [{"e": 1}], "same": "x", "none": None}
    other = {"a": {"b": 2, "c": [1, 3]}, "d": [{"e": 1}, {"e": 4}], "same": "x", "none": None}
    assert differences([first, other]) == [("a.b", ["1", "2"]), ("a.c", ["1, 2", "1, 3"]), ("d.1.e", ["–", "4"])]
    assert differences([first, first]) == []


async def test_values_that_differ_look_different() -> None:
    near, nearer = {"distance": 1.80001, "background": None}, {"distance": 1.8, "background": {}}
    assert differences([near, nearer]) == [("distance", ["1.80001", "1.8"]), ("background", ["–", "{}"])]
