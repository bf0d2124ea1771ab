"""The study of questions: its page, tables of made-up jobs, and a record of a campaign that is run here."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.study import tables
from benchmarks.study.pages import VQA
from benchmarks.study.record import Asked, Record, load, save
from benchmarks.study.recording import of_folder
from scene_attack.runs.campaign_plan import write
from scene_attack.runs.campaign_run import run_campaign
from scene_attack.runs.campaign_spec import parse
from scene_attack.runs.task_parts import Member
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import Facts, answer
from scene_attack_questions.grid import QuestionGrid, QuestionMember
from scene_attack_questions.source import Clevr
from tests.unit.docs.study.test_study_page import row
from tests.unit.docs.study.test_study_records import SMALL, job
from tests.unit.jobs.small import LIBRARY
from tests.unit.questions.question_campaign import GRIDS, answering, asked, commonest, right_at_times

pytestmark = pytest.mark.slow

TABLE_2 = "96.33 2.1 83.67 6.8 48.67 9.5 8.33 12.3 90.67 8.8"
"""The row of the paper's second table as printed: per cent, then p ×10⁻³, of each of its five columns."""
EXAMPLES = Path(__file__).parents[4] / "examples"


def question(**changes: Any) -> Asked:
    about = {"text": "What shape is it?", "family": "zero_hop", "kind": "shape", "right": "cube", "right_after": "cube"}
    about |= {"functions": ("scene", "filter_color", "unique", "query_shape")}
    answers = {"before": "cube", "before_confidence": 0.9, "after": "no", "after_confidence": 0.5, "of_kind": False}
    return Asked.model_validate(about | answers | {"outcome": "fooled", "first": 1} | changes)


def record_of(tmp_path: Path, *jobs: Any) -> Record:
    whole = json.loads((SMALL / "vqa-differentiable.json").read_text("utf-8"))
    whole["jobs"] = [one.model_dump(mode="json") for one in jobs]
    (tmp_path / "r.json").write_text(json.dumps(whole), "utf-8")
    return load(tmp_path / "r.json")


HELD = {"outcome": "held", "verified": False}


@pytest.fixture
def record(tmp_path: Path) -> Record:
    """Four questions by "normals", of which three fell, and one scene with two questions, which counts in no table."""
    of_kind = question(after="sphere", of_kind=True, first=3)
    long = question(family="two_hop", functions=("scene", *["filter_color"] * 6, "unique", "query_shape"), first=7)
    held = question(family="two_hop", after="cube", of_kind=True, outcome="held", first=None)
    return record_of(
        tmp_path,
        job(0.01, "a", attack="normals", questions=(question(),)),
        job(0.01, "b", attack="normals", questions=(of_kind,)),
        job(0.01, "c", attack="normals", questions=(long,)),
        job(0.01, "d", attack="normals", questions=(held,), **HELD),
        job(0.01, "e", attack="normals, two questions", questions=(question(), question())),
    )


def cells(table: str) -> list[list[str]]:
    """The cells of a table's rows below its head."""
    lines = [line for line in table.splitlines() if line.startswith("|")][2:]
    return [[cell.strip().replace("\u00a0", " ") for cell in line.strip("|").split("|")] for line in lines]


def test_success_by_what_was_asked(record: Record) -> None:
    assert cells(tables.by_question(record)) == [
        ["**family**", "zero hop", "2 of 2"],
        ["", "two hop", "1 of 2"],
        ["**answer**", "shape", "3 of 4"],
        ["**functions**", "1–6", "2 of 3"],
        ["", "7–12", "1 of 1"],
    ]


def test_answers_that_left_their_kind_are_counted_and_named(record: Record) -> None:
    text = tables.left_kind(record)
    assert cells(text) == [["normals", "3", "2", "boolean 2"]]
    assert text.count("“What shape is it?” cube, then **no**") == 2


def test_the_module_that_was_fooled_first_is_counted_of_the_programs_that_have_it(record: Record) -> None:
    assert cells(tables.fooled_first(record)) == [
        ["scene", "0 of 3"],
        ["filter", "1 of 3"],
        ["unique", "1 of 3"],
        ["query", "1 of 3"],
    ]


def test_the_papers_row_is_the_papers(tmp_path: Path) -> None:
    """Of the network that ships; the small records are of a seeded one, of which the paper has no row."""
    for path in SMALL.glob("vqa-*.json"):
        (tmp_path / path.name).write_text(path.read_text("utf-8").replace('"iep-right"', '"iep"'), "utf-8")
    found = row(VQA.files(tmp_path)[VQA.name], "IEP", "paper")
    values = [float(value) for cell in found[3:8] for value in cell.split("\u00a0·\u00a0")]
    assert values == [pytest.approx(float(one), abs=0.05) for one in TABLE_2.split()]


def scene_record(member: Member) -> SceneRecord:
    assert isinstance(member.scene.source, Clevr)
    return member.scene.source.stated()


@pytest.mark.parametrize("name", VQA.curves)
def test_the_campaigns_are_of_scenes_that_no_training_used_and_at_least_as_large_as_the_papers(name: str) -> None:
    campaign = parse(json.loads((EXAMPLES / f"paper-{name}.json").read_text("utf-8")))
    assert campaign.name == f"paper-{name}"
    for grid in campaign.grids:
        assert isinstance(grid.generate, QuestionGrid)
        assert min(grid.generate.size) >= 224
        assert grid.generate.shadows
        assert scene_record(grid.sample()).split == "new"
        assert [target.name for target in grid.targets] == ["iep"]
        assert grid.selection.prefer == "listed"


def test_a_campaign_with_questions_becomes_a_record_that_says_the_same(tmp_path: Path) -> None:
    with answering(right_at_times()):
        found = run_campaign(parse(GRIDS), tmp_path, LIBRARY)
    write(found, tmp_path)
    made = of_folder(tmp_path)
    save(made, tmp_path / "record.json")
    again = load(tmp_path / "record.json")
    assert again == made
    right = [one for one in asked() if one.answer == commonest()]
    every = [one for one in parse(GRIDS).grids[0].members() if isinstance(one, QuestionMember)]
    members = {member.questions[0].question: member for member in every}
    assert len(again.jobs) == 2 * len(right)
    for one in again.jobs:
        [about] = one.questions
        member = members[about.text]
        assert one.mesh == scene_record(member).image_filename.removesuffix(".png")
        program = member.questions[0].program
        assert program is not None
        assert about.functions == tuple(node.function for node in program.nodes)
        assert (about.family, about.right) == ("zero_hop", answer(program, Facts.of(scene_record(member))))
        assert (about.before, about.after) == (one.before, one.after)
        assert (about.first is None) == (not one.success)
    image = next(one for one in again.jobs if one.attack == "image")
    assert image.success
    assert image.questions[0].first in range(len(image.questions[0].functions))
    [views] = {(one.asked, one.meshes) for one in again.views}
    assert views == (4, len(right))
