"""The page of a job with questions, rendered from the result of a real job on a network with seeded weights."""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from httpx import ASGITransport
from sqlalchemy import update

from scene_attack.runs.execute import execute
from scene_attack.runs.result import Result, outcome
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.targets import registry
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.page import Chain, Page, Question
from scene_attack_questions.parts import QuestionsResult
from scene_attack_service.jobs.models import Artifact, Job
from scene_attack_service.jobs.record import Record
from tests.unit.api.dashboard_records import Tags, add, app, start
from tests.unit.api.test_dashboard_pages import HOSTILE
from tests.unit.jobs.small import LIBRARY
from tests.unit.questions.iep.seeded import INFO, program, target

RECORD = generate(8, 2, objects=(4, 4))
"""A large red rubber cylinder (0), a yellow (1) and a blue (2) large metal one, a large red rubber sphere (3)."""
CALLS = program(
    "scene",
    "filter_color 0 red",
    "filter_shape 1 cylinder",
    "unique 2",
    "same_size 3",
    "scene",
    "filter_material 5 metal",
    "union 4 6",
    "filter_shape 7 sphere",
    "count 8",
).written()

pytestmark = [pytest.mark.slow, pytest.mark.anyio]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The result of a job, and the folder of its files."""
    folder = tmp_path_factory.mktemp("job")
    scene = describe(RECORD, (60, 80)).model_copy(update={"shadows": None})
    source = {"format": "clevr", "record": RECORD.model_dump(mode="json")}
    request = {
        "scene": scene.model_dump(mode="json") | {"source": source},
        "target": {"name": INFO.name, "ask": {"question": CALLS}},
        "attack": {"renderer": "image", "base_renderer": "pyrender", "method": "fgsm", "steps": 1},
    }
    with registry.registered(INFO, target()):
        found = execute(parse(request), folder, LIBRARY)
    return json.loads(found.model_dump_json()), folder


@pytest.fixture
def result(made: tuple[dict[str, Any], Path]) -> dict[str, Any]:
    """The result, to be changed."""
    return copy.deepcopy(made[0])


def questions(result: dict[str, Any]) -> tuple[Question, ...]:
    """The questions as the page draws them."""
    part = QuestionsResult.model_validate(result["tasks"]["questions"])
    shown = part.shown(result["spec"], result)
    assert isinstance(shown, Page)
    return shown.questions


async def pages(record: Record, folder: Path, result: dict[str, Any]) -> tuple[str, Tags, Tags]:
    """The job's id, its page and the list, for a job that ended with this result."""
    job = add(record, JobSpec.model_validate(result["spec"]))
    files = [
        Artifact(job_id=job.id, name=file.name, sha256="ab" * 32, media_type="image/png", size=file.stat().st_size)
        for file in sorted(folder.iterdir())
    ]
    line = outcome(Result.model_validate(result))
    assert record.leases.succeed(start(record, job), result, line, files)
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        page, listed = await client.get(f"/jobs/{job.id}"), await client.get("/")
    assert page.status_code == listed.status_code == 200
    return job.id, Tags(page.text), Tags(listed.text)


async def test_the_page_has_the_question_its_answers_and_its_program(
    record: Record, made: tuple[dict[str, Any], Path]
) -> None:
    result, folder = made
    job_id, page, listed = await pages(record, folder, result)
    [found] = result["tasks"]["questions"]["questions"]
    name = "A program of 10 functions that asks for a number"
    for tags in (page, listed):
        assert name in tags.text
        assert f"{found['before']['label']} {100 * found['before']['confidence']:.1f} %" in tags.text
    for words in (
        "Right answer 1 1 The network says",
        "1 those that are red filter_color[red] a set of objects; right: 0, 3 before after",
        "3 the only one unique an object; right: object 0",
        "4 others of its size same_size a set of objects; right: 1, 2, 3",
        "7 those in either set union a set of objects; right: 1, 2, 3",
        "9 how many? count a number; right: 1",
        "3 large red rubber sphere",
        "19 files of the task",
    ):
        assert words in page.text
    # every image is a file of the job, and every mask is shown on the image that it is of
    sources = [a["src"] or "" for a in page.all("img") if "artifacts" in (a["src"] or "")]
    names = [source.removeprefix(f"/v1/jobs/{job_id}/artifacts/") for source in sources]
    assert all((folder / one).is_file() for one in names)
    shown = list(zip(names[3::2], names[4::2], strict=True))
    assert len(shown) == 2 * len(found["attention"]) == 18
    for of in found["attention"]:
        assert ("original.png", of["before"]) in shown
        assert ("attacked.png", of["after"]) in shown
    assert all("alt" in a for a in page.all("img"))
    described = [a["alt"] for a in page.all("img") if "attention" in (a["src"] or "")]
    assert "Attention of function 1, those that are red, to the attacked image" in described
    assert len(set(described)) == len(described)
    assert all("scope" in a for a in page.all("th"))
    assert len(page.all("h1")) == 1
    assert not [attributes for _, attributes in page.found if "style" in attributes]
    assert [a["id"] for a in page.all("details") if "open" in a] == ["program-0"]


async def test_the_function_that_changed_first_and_the_one_that_changed_most_are_marked(
    record: Record, made: tuple[dict[str, Any], Path], result: dict[str, Any]
) -> None:
    changes = {0: (0.4, 0.1), 1: (0.9, 0.49), 2: (2.1, 0.98), 4: (3.25, 0.97)}
    for one in result["tasks"]["questions"]["questions"][0]["attention"]:
        one["change"], one["cell_change"] = changes.get(one["node"], (0.0, 0.0))
    _, page, _ = await pages(record, made[1], result)
    assert "first at function 2, those that are cylinders , by 2.10, and most at function 4" in page.text
    assert "changed by 2.10 0.98 at a cell first changed 3 the only one" in page.text
    assert "changed by 3.25 0.97 at a cell changed most" in page.text
    steps = [a["class"] for a in page.all("li") if (a.get("class") or "").startswith("step")]
    assert [place for place, kind in enumerate(steps) if kind != "step"] == [2, 4]
    meters = [a for a in page.all("meter") if "max" in a and a["max"] == "3.25"]
    assert [a["value"] for a in meters[:5]] == ["0.4", "0.9", "2.1", "0.0", "3.25"]
    assert page.text.count("first changed") == page.text.count("changed most") == 1
    for one in result["tasks"]["questions"]["questions"][0]["attention"]:
        one["change"] = one["cell_change"] = 0.0
    _, page, _ = await pages(record, made[1], result)
    assert "No function’s attention changed." in page.text
    assert "changed most" not in page.text


async def test_an_answer_outside_the_question_s_kind_is_flagged(
    record: Record, made: tuple[dict[str, Any], Path], result: dict[str, Any]
) -> None:
    result["tasks"]["questions"]["questions"][0] |= {
        "after_of_kind": False,
        "before_of_kind": True,
        "right_after": None,
    }
    result["tasks"]["questions"]["questions"][0]["after"]["label"] = "no"
    _, page, _ = await pages(record, made[1], result)
    assert "The question asks for a number, and no is not that." in page.text
    assert page.text.count("asked for a number") == 2  # in the table of answers, and at the program's end
    assert "none: ill-posed in the attacked scene" in page.text
    assert len([a for a in page.all("span") if a.get("class") == "badge outside"]) == 2


async def test_several_questions_have_their_own_answers(
    record: Record, made: tuple[dict[str, Any], Path], result: dict[str, Any]
) -> None:
    asked = result["tasks"]["questions"]["questions"]
    other = copy.deepcopy(asked[0]) | {"question": "How many things are there?", "outcome": "held"}
    other["before"]["label"], other["after"]["label"] = "3", HOSTILE
    asked[0]["outcome"] = "fooled"
    asked.append(other)
    result["spec"]["target"] = {"name": INFO.name, "ask": {"questions": [CALLS, other["question"]]}}
    result["original"]["label"] = "an answer stays"
    _, page, listed = await pages(record, made[1], result)
    assert "2 questions about one image" in listed.text
    assert f"3 → {HOSTILE}" in listed.text
    assert "it answers 1 wrongly under attack" in page.text
    assert "it says an answer stays" not in page.text
    assert "How many things are there? held" in page.text
    assert [a["id"] for a in page.all("details") if (a.get("id") or "").startswith("program")] == [
        "program-0",
        "program-1",
    ]
    assert all((a["src"] or "").startswith("/static/") for a in page.all("script"))


async def test_objects_have_their_effects_and_the_search_its_limits(
    record: Record, made: tuple[dict[str, Any], Path], result: dict[str, Any]
) -> None:
    shares = {"effect": -1.0, "shapley": [-0.75, -0.25], "interactions": None, "standard_error": None}
    result["analyses"]["coordinates"] = {
        "parts": ["object 2 image", "light 0 energy"],
        "method": "sampled",
        "orders": 4,
        "images": 9,
        "log_odds": shares,
        "probability": shares,
    }
    limit = {"part": "image", "what": "coordinates", "kept": 8, "of": 12, "why": "objects stay upright", "error": 0.0}
    result["plan"]["items"].append(limit)
    _, page, _ = await pages(record, made[1], result)
    assert "2 large blue metal cylinder -0.750 3 large red rubber sphere Limits of the search" in page.text
    assert "pixels 8 12 objects stay upright What changed" in page.text


def test_a_function_that_many_take_is_shown_in_whole_once(result: dict[str, Any]) -> None:
    """Each function takes the one before it twice: as a tree without sharing, 2^60 functions."""
    doubled = program("scene", *(f"union {k} {k}" for k in range(60)), "count 60").written()
    result["tasks"]["questions"]["questions"][0] |= {"program": doubled, "attention": []}
    [found] = questions(result)

    def steps(chain: Chain) -> Iterator[tuple[int, bool]]:
        for one in chain.inputs:
            yield from steps(one)
        for step in chain.steps:
            yield step.number, step.shown_before

    shown = list(steps(found.program))
    assert sorted(number for number, before in shown if not before) == list(range(62))
    assert sorted(number for number, before in shown if before) == list(range(60))
    assert shown.index((5, False)) < shown.index((5, True))
    assert [step.words for step in found.program.steps] == ["those in either set", "how many?"]


async def test_a_job_of_an_older_version_is_shown(record: Record, made: tuple[dict[str, Any], Path]) -> None:
    result, folder = made
    job_id, _, _ = await pages(record, folder, result)
    older = result["spec"] | {"target": {"name": INFO.name, "question": CALLS}}
    with record.database.write() as session:
        session.execute(update(Job).where(Job.id == job_id).values(spec=older))
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        page = await client.get(f"/jobs/{job_id}")
    assert page.status_code == 200
    assert "A program of 10 functions that asks for a number" in Tags(page.text).text


def test_a_chain_is_read_in_the_order_in_which_its_functions_run(result: dict[str, Any]) -> None:
    [found] = questions(result)
    joined = found.program
    assert [step.number for step in joined.steps] == [7, 8, 9]
    assert [[step.number for step in chain.steps] for chain in joined.inputs] == [[0, 1, 2, 3, 4], [5, 6]]
    assert [chain.inputs for chain in joined.inputs] == [(), ()]
    assert [step.label for step in joined.steps if step.is_answer] == ["count"]
