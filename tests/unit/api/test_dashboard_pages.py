"""The pages, rendered from a real record and parsed as a browser would."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import httpx
import pytest
from httpx import ASGITransport

from services.errors import InvalidRequest
from services.jobs.record import Record
from services.pipeline.result import JobWarning
from services.pipeline.spec import parse
from tests.unit.api.dashboard_records import SPEC, add, app, open_record, result, row, start, succeed
from tests.unit.jobs.records import attacks

HOSTILE = "<script>alert(1)</script>\"'&"


class Tags(HTMLParser):
    """All start tags with their attributes, and all text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    with open_record(tmp_path) as made:
        yield made


async def get(record: Record, path: str) -> httpx.Response:
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        return await client.get(path)


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


pytestmark = [pytest.mark.slow, pytest.mark.anyio]


async def test_an_empty_list_says_how_to_begin(record: Record) -> None:
    page = await get(record, "/")
    assert page.status_code == 200
    assert "scene-attack submit" in page.text


async def test_list_shows_state_and_outcome_newest_first(record: Record) -> None:
    succeed(record, add(record), result())
    record.leases.fail(start(record, add(record)), "timeout", "3600 seconds")
    add(record)
    tags = Tags((await get(record, "/")).text)
    assert [a["href"] for a in tags.all("a") if (a["href"] or "").startswith("/jobs/")] == [
        f"/jobs/{job.id}" for job in attacks(record)
    ]
    badges = [a["class"] for a in tags.all("span") if (a.get("class") or "").startswith("badge state")]
    assert badges == ["badge state-queued", "badge state-failed", "badge state-succeeded"]
    assert "grand piano 77.0 % → upright 55.0 %" in tags.text
    assert "12.30" in tags.text
    assert "1,234" in tags.text
    assert "timeout" in tags.text
    assert tags.text.count("torch combined fgsm against efficientnet-lite0") == 3


async def test_list_is_paged_and_filtered(record: Record) -> None:
    for _ in range(51):
        add(record)
    record.leases.fail(start(record, add(record)), "internal", "x")
    first = Tags((await get(record, "/")).text)
    rows = [a for a in first.all("a") if (a["href"] or "").startswith("/jobs/")]
    older = next(a["href"] for a in first.all("a") if "cursor=" in (a["href"] or ""))
    assert older is not None
    second = Tags((await get(record, older)).text)
    rest = [a for a in second.all("a") if (a["href"] or "").startswith("/jobs/")]
    assert len(rows) == 50
    assert len(rest) == 2
    assert not {a["href"] for a in rows} & {a["href"] for a in rest}
    failed = Tags((await get(record, "/?q=state:failed")).text)
    assert len([a for a in failed.all("a") if (a["href"] or "").startswith("/jobs/")]) == 1


async def test_job_page_tells_the_whole_result(record: Record) -> None:
    job = add(record)
    succeed(record, job, result())
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    images = [a["src"] for a in tags.all("img") if "artifacts" in (a["src"] or "")]
    assert images == [f"/v1/jobs/{job.id}/artifacts/{name}.png" for name in ("original", "attacked", "perturbation")]
    for words in (
        "it says upright (55.0 %) where it said grand piano (77.0 %)",
        "p of surface normals 20.00 × 10⁻³",
        "surface normals + illumination upright 60.0 % 31.0 % 7.50 (8.00 as saved) fooled",
        "Perceptibility p = 11.70 (12.30 as saved) × 10⁻³ after 5 steps",
        "surface normals -2.250 -31.00 % +0.500 with illumination",
        "all -3.000 -40.00 %",
        "“Grand piano” by Dante, CC0 1.0",
        "harp 0.0021 %",
        "Tolerance 1.0e-03; estimated error 4.2e-04 (largest difference of a displayed value from the exact image)",
        "In the image of the stored perturbation the largest difference is 1.5e-04.",
        "object 0 normals 1.0e-02 2.5 %",
        "object 0 lobes 4 9 five are <dark> 2.0e-05",
        "object 0 pixels looked up every image 9,293 lookups 11 times less work 4.0e-04",
        "off by 2.5e-05 at most in the mean over covered pixels",
        "and by more than 1/255 in 0.3 % of them",
        "5c" * 32,
        f"Mesh furniture/grand-piano {'9a' * 32}",
        f"Extension mine.py {'1f' * 32}",
        "delta, measured at the start normals 0.001",
        "after 5 steps, 1,234 queries, 1.2 s",
        "queued just now , started just now , succeeded just now",
        "stopped because it found an adversary that holds when rendered afresh",
    ):
        assert words in tags.text
    labels = [a["aria-label"] for a in tags.all("svg")]
    assert labels.pop(0) == "Subsets of the groups"
    assert len(labels) == 12  # four curves, against steps, queries and seconds
    assert labels[0] == "Probability of “grand piano”: 0.8 at 0, 0.0622 at 5 (step)"
    assert labels[4] == "Probability of “grand piano”: 0.8 at 2, 0.0622 at 12 (queries)"
    assert labels[8] == "Probability of “grand piano”: 0.8 at 0, 0.0622 at 1.25 (seconds)"
    assert "5 12 1.2 upright 55.0 % 0.06221 -2 15.00 10" in tags.text  # the table behind the curves


async def test_fooled_but_not_verified_is_not_called_an_adversary(record: Record) -> None:
    job = add(record)
    succeed(record, job, result(outcome="held", verified=False, stopped="steps"))
    text = Tags((await get(record, f"/jobs/{job.id}")).text).text
    assert "rendered afresh does not fool it" in text
    assert "not verified" in text


@pytest.mark.parametrize(
    ("outcome", "sentence"),
    [
        ("fooled", "The network was fooled: it says upright (55.0 %) where it said grand piano"),
        ("changed", "nobody has said which answer is right: it says upright"),
        ("became-right", "The network was wrong before the attack and became right: it says upright"),
        ("still-wrong", "wrong before the attack and still is, which is no success: it says upright"),
        ("held", "The network held: it says upright (55.0 %) where it said grand piano (77.0 %), which is not"),
    ],
)
async def test_each_outcome_has_its_badge_and_its_sentence(record: Record, outcome: str, sentence: str) -> None:
    job = add(record)
    met = outcome != "held"
    succeed(record, job, result(outcome=outcome, fooled=met, verified=met, truth=["harp"]))
    paths = (f"/jobs/{job.id}", "/", f"/compare?job={job.id}&job={add(record).id}")
    page, listed, compared = [Tags((await get(record, path)).text) for path in paths]
    assert f"Fooled, verified {int(outcome == 'fooled')} of 1" in listed.text
    for tags in (page, listed, compared):
        classes = [a.get("class") for a in tags.all("span")]
        assert f"badge {outcome}" in classes
        assert ("badge verified" in classes) == (outcome in ("fooled", "changed"))
    assert sentence in page.text
    assert ("Right is harp. Perceptibility p" in page.text) == met


async def test_the_job_s_page_has_its_warnings(record: Record) -> None:
    warning = JobWarning(code="already-wrong", field="goal.truth", text="it says <harp>, not 'upright'")
    job = add(record, warnings=[warning])
    assert "goal.truth it says <harp>, not 'upright'" in Tags((await get(record, f"/jobs/{job.id}")).text).text


async def test_running_job_shows_the_trace_so_far_and_listens(record: Record) -> None:
    job = add(record)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 2, 120, [row(0), row(1), row(2)])
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    assert "Attacking, step 2 of at most 120." in tags.text
    assert "after 6 queries" in tags.text
    assert len(tags.all("svg")) == 12
    assert any(a.get("data-events") == f"/v1/jobs/{job.id}/events" for a in tags.all("div"))
    assert any(a.get("action") == f"/jobs/{job.id}/cancel" for a in tags.all("form"))


async def test_a_job_that_is_being_prepared_names_no_step(record: Record) -> None:
    """Measuring the noise before ZOO's first step takes seconds, in which "step 0" looked like a job that hangs."""
    job = add(record)
    record.leases.progress(start(record, job), "loading", 0, 120, [])
    text = Tags((await get(record, f"/jobs/{job.id}")).text).text
    assert "Preparing the scene, its plan and the attack." in text
    assert "step 0" not in text


async def test_failed_job_says_why_in_plain_words(record: Record) -> None:
    job = add(record)
    record.leases.fail(start(record, job), "worker-lost", "its process died 3 times")
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    assert "The process running the job died more often than it may be restarted." in tags.text
    assert "its process died 3 times" in tags.text
    assert not [form for form in tags.all("form") if str(form["action"]).endswith("/cancel")]


async def test_a_rejected_job_names_its_bad_fields(record: Record) -> None:
    job = add(record)
    record.leases.reject(start(record, job), InvalidRequest("goal.reach", "there is no label 'tensch'"))
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    assert "Why it was rejected" in tags.text
    assert "goal.reach" in tags.text
    assert "there is no label 'tensch'" in tags.text
    assert not [form for form in tags.all("form") if str(form["action"]).endswith("/cancel")]


async def test_cancel_button_cancels(record: Record) -> None:
    job = add(record)
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        answer = await client.post(f"/jobs/{job.id}/cancel")
        assert answer.status_code == 303
        assert answer.headers["location"] == f"/jobs/{job.id}"
        assert (await client.post("/jobs/unknown/cancel")).status_code == 404
    found = record.jobs.get(job.id)
    assert found is not None
    assert found.state == "cancelled"


async def test_whatever_a_job_says_is_text_and_never_markup(record: Record) -> None:
    spec = SPEC.model_copy(
        update={
            "scene": SPEC.scene.model_copy(
                update={"objects": (SPEC.scene.objects[0].model_copy(update={"mesh": HOSTILE}),)}
            )
        }
    )
    job = add(record, spec)
    found = result(spec, leave=HOSTILE)
    found["attacked"]["label"] = found["attacked"]["top"][0][0] = found["subsets"][0]["label"] = HOSTILE
    found["provenance"]["credits"] = [HOSTILE]
    found["settings"] = {HOSTILE: HOSTILE}
    succeed(record, job, found)
    failed = add(record, spec)
    record.leases.fail(start(record, failed), "internal", HOSTILE)
    for path in ("/", f"/jobs/{job.id}", f"/jobs/{failed.id}"):
        tags = Tags((await get(record, path)).text)
        assert [a.get("src") for a in tags.all("script")] == [a["src"] for a in tags.all("script")]
        assert all((a["src"] or "").startswith("/static/") for a in tags.all("script"))
        assert "alert(1)" in tags.text


async def test_pages_keep_their_own_content_policy(record: Record) -> None:
    """Nothing inline that the policy would block, nothing from elsewhere, and what a screen reader needs is there."""
    job, targeted = add(record), add(record, parse(SPEC.model_dump() | {"goal": {"reach": "harp"}}))
    succeed(record, job, result())
    record.leases.progress(start(record, targeted), "attacking", 0, 120, [row(0)])
    for path in ("/", f"/jobs/{job.id}", f"/jobs/{targeted.id}"):
        page = await get(record, path)
        assert "default-src 'none'" in page.headers["content-security-policy"]
        tags = Tags(page.text)
        for tag, attributes in tags.found:
            assert "style" not in attributes
            assert not [name for name in attributes if name.startswith("on")]
            for name in ("src", "href", "action"):
                assert (attributes.get(name) or "/").startswith(("/", "#")), (tag, attributes)
                assert not (attributes.get(name) or "/").startswith("//")
        assert all("alt" in a for a in tags.all("img"))
        assert all("scope" in a for a in tags.all("th"))
        assert len(tags.all("h1")) == 1
        assert not tags.all("style")


async def test_static_files_are_kept_only_under_their_version(record: Record) -> None:
    page = await get(record, "/")
    style = next(a["href"] for a in Tags(page.text).all("link") if a["rel"] == "stylesheet")
    assert style is not None
    assert "immutable" in (await get(record, style)).headers["cache-control"]
    assert (await get(record, "/static/style.css")).headers["cache-control"] == "no-cache"
    assert (await get(record, f"/static/{'0' * 12}/style.css")).status_code == 404
    assert (await get(record, "/static/..%2froutes.py")).status_code == 404
