"""The pages of jobs, rendered from a real record and parsed as a browser would."""

import httpx
import pytest
from httpx import ASGITransport

from scene_attack.client.states import Priority
from scene_attack.errors import InvalidRequest
from scene_attack.runs.result import JobWarning, Result, outcome
from scene_attack.runs.spec import JobSpec, parse
from scene_attack_service.jobs.models import Artifact, Job
from scene_attack_service.jobs.queue import Demand, Needs, Waiting
from scene_attack_service.jobs.record import Record
from tests.unit.api.dashboard_records import ATTRIBUTION, SPEC, Tags, add, app, result, row, send, start, succeed
from tests.unit.jobs.records import attacks

HOSTILE = "<script>alert(1)</script>\"'&"


pytestmark = pytest.mark.anyio


async def test_an_empty_list_says_how_to_begin(record: Record) -> None:
    page = await send(record, "/")
    assert page.status_code == 200
    assert "scene-attack submit" in page.text


async def test_list_shows_state_and_outcome_newest_first(record: Record) -> None:
    succeed(record, add(record), result())
    record.leases.fail(start(record, add(record)), "timeout", "3600 seconds")
    add(record)
    tags = Tags((await send(record, "/")).text)
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
    first = Tags((await send(record, "/")).text)
    rows = [a for a in first.all("a") if (a["href"] or "").startswith("/jobs/")]
    older = next(a["href"] for a in first.all("a") if "cursor=" in (a["href"] or ""))
    assert older is not None
    second = Tags((await send(record, older)).text)
    rest = [a for a in second.all("a") if (a["href"] or "").startswith("/jobs/")]
    assert len(rows) == 50
    assert len(rest) == 2
    assert not {a["href"] for a in rows} & {a["href"] for a in rest}
    failed = Tags((await send(record, "/?q=state:failed")).text)
    assert len([a for a in failed.all("a") if (a["href"] or "").startswith("/jobs/")]) == 1


async def test_job_page_tells_the_whole_result(record: Record) -> None:
    job = add(record)
    succeed(record, job, result())
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
    images = [a["src"] for a in tags.all("img") if "artifacts" in (a["src"] or "")]
    assert images == [f"/v1/jobs/{job.id}/artifacts/{name}.png" for name in ("original", "attacked", "perturbation")]
    for words in (
        "it says upright (55.0 %) where it said grand piano (77.0 %)",
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
        f"Plug-in mine 1.0 {'1f' * 32}",
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
    text = Tags((await send(record, f"/jobs/{job.id}")).text).text
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
    page, listed, compared = [Tags((await send(record, path)).text) for path in paths]
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
    assert "goal.truth it says <harp>, not 'upright'" in Tags((await send(record, f"/jobs/{job.id}")).text).text


async def test_running_job_shows_the_trace_so_far_and_listens(record: Record) -> None:
    job = add(record)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 2, 120, [row(0), row(1), row(2)])
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
    assert "Attacking, step 2 of at most 120." in tags.text
    assert "after 6 queries" in tags.text
    assert len(tags.all("svg")) == 12
    assert any(a.get("data-events") == f"/v1/jobs/{job.id}/events" for a in tags.all("div"))
    assert any(a.get("action") == f"/jobs/{job.id}/cancel" for a in tags.all("form"))


async def test_a_job_that_is_being_prepared_names_no_step(record: Record) -> None:
    """Measuring the noise before ZOO's first step takes seconds, in which "step 0" looked like a job that hangs."""
    job = add(record)
    record.leases.progress(start(record, job), "loading", 0, 120, [])
    text = Tags((await send(record, f"/jobs/{job.id}")).text).text
    assert "Preparing the scene, its plan and the attack." in text
    assert "step 0" not in text


async def test_failed_job_says_why_in_plain_words(record: Record) -> None:
    job = add(record)
    record.leases.fail(start(record, job), "worker-lost", "its process died 3 times")
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
    assert "The process running the job died more often than it may be restarted." in tags.text
    assert "its process died 3 times" in tags.text
    assert not [form for form in tags.all("form") if str(form["action"]).endswith("/cancel")]


async def test_a_rejected_job_names_its_bad_fields(record: Record) -> None:
    job = add(record)
    record.leases.reject(start(record, job), InvalidRequest("goal.reach", "there is no label 'tensch'"))
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
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
    found["measured"]["settings"] = {HOSTILE: HOSTILE}
    succeed(record, job, found)
    failed = add(record, spec)
    record.leases.fail(start(record, failed), "internal", HOSTILE)
    for path in ("/", f"/jobs/{job.id}", f"/jobs/{failed.id}"):
        tags = Tags((await send(record, path)).text)
        assert [a.get("src") for a in tags.all("script")] == [a["src"] for a in tags.all("script")]
        assert all((a["src"] or "").startswith("/static/") for a in tags.all("script"))
        assert "alert(1)" in tags.text


async def test_pages_keep_their_own_content_policy(record: Record) -> None:
    """Nothing inline that the policy would block, nothing from elsewhere, and what a screen reader needs is there."""
    job, targeted = add(record), add(record, parse(SPEC.model_dump() | {"goal": {"reach": "harp"}}))
    succeed(record, job, result())
    record.leases.progress(start(record, targeted), "attacking", 0, 120, [row(0)])
    for path in ("/", f"/jobs/{job.id}", f"/jobs/{targeted.id}"):
        page = await send(record, path)
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
    page = await send(record, "/")
    style = next(a["href"] for a in Tags(page.text).all("link") if a["rel"] == "stylesheet")
    assert style is not None
    assert "immutable" in (await send(record, style)).headers["cache-control"]
    assert (await send(record, "/static/style.css")).headers["cache-control"] == "no-cache"
    assert (await send(record, f"/static/{'0' * 12}/style.css")).status_code == 404
    assert (await send(record, "/static/..%2froutes.py")).status_code == 404


async def test_changes_stand_in_words_and_in_numbers(record: Record) -> None:
    job = add(record)
    succeed(record, job, result())
    page = Tags((await send(record, f"/jobs/{job.id}")).text).text
    assert "drill moved 4.2 cm right" in page
    assert "object 0 translation x 10 14.2 +4.2 cm" in page
    assert "curl -s http://dashboard/v1/jobs -H" in page


async def test_of_a_single_group_there_is_no_plot_and_no_table_of_subsets(record: Record) -> None:
    job = add(record)
    found = result()
    found["subsets"] = [found["subsets"][0], found["subsets"][1]]
    shares = {"effect": -3.0, "shapley": [-3.0], "interactions": [[0.0]]}
    found["attribution"] = found["attribution"] | {
        "parts": ["normals"],
        "images": 0,
        "log_odds": shares,
        "probability": shares,
    }
    succeed(record, job, found)
    page = Tags((await send(record, f"/jobs/{job.id}")).text)
    assert "Which groups did it" not in page.text
    assert "Subsets of the groups" not in [a["aria-label"] for a in page.all("svg")]


async def test_the_table_behind_the_curves_of_a_long_trace_is_short(record: Record) -> None:
    job = add(record)
    succeed(record, job, result(trace=[row(step) for step in range(1002)]))
    page = Tags((await send(record, f"/jobs/{job.id}")).text).text
    assert "evenly chosen" in page
    assert "1001 2,004 250.2" in page
    assert "1000 2,002" not in page


async def test_a_job_that_no_worker_can_run_says_why(record: Record) -> None:
    why = "no worker that is running has the network <x>"
    job = add(record)
    other, _ = record.jobs.create(SPEC, 1000, None, lambda _: {}, demand=Demand(priority=Priority.LOW))
    assert other is not None
    record.scheduler.explain(Waiting(job.priority, Needs.read(job.needs), None), why)
    assert Tags((await send(record, "/")).text).text.count(why) == 1
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
    assert f"Waiting for a worker: {why}." in tags.text
    assert any(a.get("data-poll") for a in tags.all("div")), "no event tells of a reason that has gone"
    assert "Waiting for a worker." in Tags((await send(record, f"/jobs/{other.id}")).text).text
    start(record, job)
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
    assert why not in tags.text
    assert not any(a.get("data-poll") for a in tags.all("div"))


MOVED = parse({"scene": {"objects": [{"mesh": "furniture/grand-piano"}]}, "attack": {"renderer": "pyrender"}})


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
    tags = Tags((await send(record, f"/jobs/{job.id}")).text)
    files = {side: f"/v1/jobs/{job.id}/scene.glb?which={side}" for side in sides}
    (view,) = tags.all("scene-3d")
    assert {name.removeprefix("data-"): value for name, value in view.items() if value and "glb" in value} == files
    assert [link["href"] for link in tags.all("a") if "scene.glb" in (link["href"] or "")] == list(files.values())
    assert not any("open" in part for part in tags.all("details"))


async def test_a_job_that_stored_no_perturbation_has_a_sentence(record: Record) -> None:
    job = ended(record, MOVED, "original.png")
    page = await send(record, f"/jobs/{job.id}")
    assert "stored no perturbation" in Tags(page.text).text
    assert "scene.glb" not in page.text


async def test_a_job_whose_result_is_no_file_asks_for_no_scene(record: Record) -> None:
    job = ended(record, MOVED, "perturbation.safetensors")
    page = await send(record, f"/jobs/{job.id}")
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
        assert (said in Tags((await send(record, f"/jobs/{job.id}")).text).text) == is_said


async def test_a_job_without_a_result_has_no_scene(record: Record) -> None:
    job = add(record, MOVED)
    assert "scene3d-details" not in (await send(record, f"/jobs/{job.id}")).text


BOUND = parse(
    {
        "scene": {"objects": [{"mesh": "furniture/grand-piano"}]},
        "attack": {
            "method": "apgd",
            "groups": ["normals", "illumination"],
            "constraint": "backtrack",
            "perceptibility": 0.05,
        },
    }
)
AT_EPSILON = {"normals": {"coordinates": 0, "share": 0.0}, "illumination": {"coordinates": 128, "share": 0.25}}
WORDS = "within ε, p used 11.70 of 50.00 ×10⁻³"


@pytest.mark.parametrize("at_epsilon", [AT_EPSILON, {}], ids=["bound", "free"])
async def test_lists_pages_and_comparisons_say_what_bound_a_search_that_held(
    record: Record, at_epsilon: dict[str, object]
) -> None:
    ids = []
    for stopped in ("steps", "queries"):
        job = add(record, BOUND)
        held = {"outcome": "held", "fooled": False, "verified": False, "stopped": stopped, "at_epsilon": at_epsilon}
        succeed(record, job, result(BOUND, **held))
        ids.append(job.id)
    pages = {}
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        for path in ("/", f"/jobs/{ids[0]}", f"/compare?jobs={','.join(ids)}"):
            answer = await client.get(path)
            assert answer.status_code == 200, answer.text
            pages[path] = Tags(answer.text).text.replace("\N{NO-BREAK SPACE}", " ")
    for text in pages.values():
        assert (f"held {WORDS}" in text) == bool(at_epsilon)
    sentence = "Its ε bound the search: 128 values of illumination (25.0 %) ended at it. Beyond it nothing was tried."
    assert (sentence in pages[f"/jobs/{ids[0]}"]) == bool(at_epsilon)


ANALYSES = {
    "coordinates": ATTRIBUTION
    | {
        "method": "sampled",
        "orders": 12,
        "log_odds": {"effect": -3.0, "shapley": [-2.5, -0.5], "standard_error": [0.125, 0.0625]},
    },
    "minimal": {
        "smallest": {
            "scale": 0.25,
            "label": "upright",
            "confidence": 0.5,
            "goal_probability": 0.3,
            "float_perceptibility": 0.002,
            "perceptibility": 0.003,
            "fooled": True,
        },
        "holds_at": 0.2,
        "fools_from": 0.75,
        "scan": [],
        "images": 24,
        "change": [
            {"group": "rotation", "subject": "object 0", "measure": "angle", "value": 1.5, "unit": "degrees"},
        ],
        "stored_change": [
            {"group": "rotation", "subject": "object 0", "measure": "angle", "value": 6.0, "unit": "degrees"},
        ],
    },
    "transfer": [
        {
            "target": name,
            "before": {"label": "piano", "confidence": 0.9},
            "after": {"label": "<desk>", "confidence": 0.4},
            "outcome": outcome,
            "right_before": right,
        }
        for name, right, outcome in (("a", True, "fooled"), ("b", False, "still-wrong"), ("c", None, "changed"))
    ],
    "second_opinion": [
        {
            "renderer": "tracer",
            "before": {"label": "piano", "confidence": 0.9},
            "after": {"label": "<desk>", "confidence": 0.4},
            "outcome": "held",
            "right_before": True,
            "share": 0.5,
            "note": "without map",
        },
        {"renderer": "broken", "failure": "it was killed"},
    ],
    "survival": {
        "variations": 64,
        "right": 50,
        "fooled": 40,
        "share": 0.8,
        "interval": [0.67, 0.887],
        "wrong_share": 0.22,
        "wrong_interval": [0.13, 0.33],
    },
    "interpretation": {
        "image": {"label": "upright", "confidence": 0.5},
        "scene": {"label": "piano", "confidence": 0.9},
        "fits": [
            {
                "optimiser": "sgd",
                "rate": 1e-4,
                "losses": [0.005, 0.004, 0.0045],
                "after": {"label": "piano", "confidence": 0.8},
                "distance": 0.01,
            }
        ],
    },
    "adaptive": {
        "fooled": False,
        "steps": 10,
        "goal_probability": [0.9, 0.8],
        "image": {"label": "desk", "confidence": 0.7},
        "rerendered": {"label": "piano", "confidence": 0.8},
        "perceptibility": 0.025,
    },
    "rerendering": {
        "optimiser": "adam",
        "rate": 1e-3,
        "losses": [0.006, 0.005],
        "before": {"label": "upright", "confidence": 0.5},
        "after": {"label": "piano", "confidence": 0.9},
        "distance": 0.012,
    },
}


async def test_job_page_shows_the_analyses_that_were_asked_for(record: Record) -> None:
    job = add(record)
    succeed(record, job, result(analyses=ANALYSES))
    text = Tags((await send(record, f"/jobs/{job.id}")).text).text
    for words in (
        "Shapley values of the coordinates, means over 12 random orders",
        "normals -2.500 ± 0.125",
        "at 25.0 % of the stored perturbation the network says upright (50.0 %), p = 2.00 (3.00 as saved) × 10⁻³",
        "at 20.0 % it held. Every scanned scale from 75.0 % on fools.",
        "rotation, object 0 angle 1.5 6 degrees",
        "a piano 90.0 % <desk> 40.0 % fooled",
        "b piano 90.0 % <desk> 40.0 % still-wrong",
        "c piano 90.0 % <desk> 40.0 % changed truth unknown",
        "tracer piano 90.0 % <desk> 40.0 % held under 50.0 % of other seeds without map",
        "broken none it was killed",
        "the network is right on 50 photographs of the original; of the attacked image it is fooled on 40 of these: "
        "the adversary survives 80.0 % (67.0 % to 88.7 %",
        "sgd 1.0e-04 5.000 4.000 piano 80.0 %",
        "fell from 6.000 to 5.000 × 10⁻³",
        "after 10 steps, at p = 25.00 × 10⁻³ as saved, the network says desk 70.0 % of the image",
        "the defence held",
    ):
        assert words in text, words


async def test_job_page_shows_the_range_and_the_surrogates_queries(record: Record) -> None:
    job = add(record)
    over = {
        "variations": 100,
        "right": 80,
        "fooled": 60,
        "share": 0.75,
        "interval": [0.645, 0.832],
        "wrong_share": 0.2,
        "wrong_interval": [0.133, 0.289],
    }
    whole = result(expectation=over, surrogate_queries=1234)
    whole["provenance"] |= {"surrogate_sha256": "5" * 64}
    succeed(record, job, Result.model_validate(whole).model_dump(mode="json"))
    text = Tags((await send(record, f"/jobs/{job.id}")).text).text
    for words in (
        "and 1,234 queries of the surrogate",
        "Of 100 fresh variations of the scene the network has 80 right without the perturbation; with it, it is fooled "
        "on 60 of these: 75.0 % (64.5 % to 83.2 %",
        "It is wrong without any perturbation on 20.0 % (13.3 % to 28.9 %)",
        "Weights of the surrogate " + "5" * 64,
    ):
        assert words in text, words
