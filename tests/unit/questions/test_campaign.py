"""Campaigns with questions: what is made of a seed, what is refused, what is attacked, and jobs that run."""

from pathlib import Path
from typing import Any

import pytest

from scene_attack.errors import Cancelled, InvalidRequest
from scene_attack.runs.campaign_plan import FirstAnswer, choose, jobs, views
from scene_attack.runs.campaign_run import run_campaign
from scene_attack.runs.campaign_spec import CampaignSpec, parse
from scene_attack.runs.check import check_size, most_jobs, placed, samples
from scene_attack.runs.spec import JobSpec
from scene_attack.runs.task_parts import Member
from scene_attack.scenes.description import Scene
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import Facts, answer
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.generator import QuestionRecord
from scene_attack_questions.grid import QuestionMember
from scene_attack_questions.parts import QuestionsPlan
from scene_attack_questions.records import Asked
from scene_attack_questions.source import Clevr
from tests.unit.jobs.small import LIBRARY
from tests.unit.questions.question_campaign import (
    COLOUR,
    GENERATE,
    GRID,
    GRIDS,
    answering,
    asked,
    commonest,
    right_at_times,
)
from tests.unit.runs.test_campaign_run import results

pytestmark = pytest.mark.slow


def changed(**generated: Any) -> CampaignSpec:
    return parse({"grids": [GRID | {"generate": GRID["generate"] | generated}]})


def questions(member: Member) -> tuple[QuestionRecord, ...]:
    assert isinstance(member, QuestionMember)
    return member.questions


def record(scene: Scene) -> SceneRecord:
    assert isinstance(scene.source, Clevr)
    return scene.source.stated()


def programs(*questions: QuestionRecord) -> dict[str, Any]:
    """What a plan states of a network that makes the right programs of these questions."""
    calls = [one.program.written() for one in questions if one.program is not None]
    asked = [Asked(question=None, program=program, kind="", right="") for program in calls]
    return {"questions": QuestionsPlan(questions=tuple(asked))}


def names(job: JobSpec) -> tuple[str, ...]:
    return () if job.target.ask is None else job.target.ask.names


def test_scenes_and_questions_follow_from_the_request() -> None:
    members = changed(questions=2).grids[0].members()
    assert members == changed(questions=2).grids[0].members()
    assert len(members) == 8
    for k, member in enumerate(members):
        assert record(member.scene) == generate(8, k // 2, objects=(3, 4))
        [question] = questions(member)
        assert question.program is not None
        assert question.answer == answer(question.program, Facts.of(record(member.scene)))
        assert question.question_family_index is not None
        assert FAMILIES[question.question_family_index].kind == "zero_hop"
        assert (member.scene.camera.size, member.scene.shadows) == ((60, 80), None)
    # a part of the scenes is the same scenes, and another seed asks others
    assert [one.scene for one in changed(first=2, images=2).grids[0].members()] == [one.scene for one in members[4::2]]
    assert changed(question_seed=3).grids[0].members() != members
    assert changed(seed=9).grids[0].members()[0].scene != members[0].scene


def test_each_question_is_a_job_or_those_of_a_scene_together() -> None:
    one = changed(questions=3)
    found = views(one)
    assert [one for view in found for one in names(view.probe)] == [
        one.question for view in found for one in questions(view.member)
    ]
    assert (len(found), most_jobs(one)) == (12, 24)
    [first, *_] = jobs(one, found, {})
    assert record(first.spec.scene) == generate(8, 0, objects=(3, 4))
    both = changed(questions=3, together=True)
    assert [names(view.probe) for view in views(both)] == [
        tuple(name for view in found[k : k + 3] for name in names(view.probe)) for k in (0, 3, 6, 9)
    ]
    with pytest.raises(InvalidRequest, match="asks the networks for 12 views"):
        check_size(parse({"grids": [GRID | {"generate": GENERATE | {"questions": 3}, "selection": {"most": 1}}]}), 11)


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"generate": GENERATE | {"images": 0}}, "grids.0.generate.images", "from 1 to 2000"),
        ({"generate": {}}, "grids.0.generate.images", "is missing"),
        ({"generate": GENERATE | {"objects": [4, 3]}}, "grids.0.generate.objects", "the fewest, 4, are more"),
        ({"generate": GENERATE | {"objects": [3, 11]}}, "grids.0.generate.objects.1", "from 1 to 10"),
        ({"generate": GENERATE | {"kinds": ["zero_hopp"]}}, "grids.0.generate.kinds.0", "did you mean 'zero_hop'"),
        ({"generate": GENERATE | {"questions": 17}}, "grids.0.generate.questions", "from 1 to 16"),
        ({"generate": GENERATE | {"together": True}}, "grids.0.generate.together", "there is one question"),
        ({"generate": GENERATE | {"scenes": 3}}, "grids.0.generate.scenes", "no such field"),
        ({"scenes": {"meshes": ["primitive/cube"]}}, "grids.0.generate", "leave it out where `scenes`"),
        ({"generate": None}, "grids.0.scenes", "or `generate`"),
        (
            {"targets": [{"name": "iep", "ask": {"question": "Is it red?"}}]},
            "grids.0.targets.0.ask",
            "what `generate` makes",
        ),
        ({"generate": GENERATE | {"leave_kind": 1}}, "grids.0.generate.leave_kind", "true or false"),
        ({"targets": ["iep", "efficientnet-lite0"]}, "grids.0.targets.1.name", "is asked nothing"),
        ({"targets": ["efficientnet-lite0"]}, "grids.0.generate", "is shown scenes"),
        ({"selection": {"prefer": "last"}}, "grids.0.selection.prefer", '"confident", "listed"'),
    ],
)
def test_a_bad_request_is_refused_by_its_field(changes: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        parse({"grids": [GRID | changes]})
    assert refused.value.field == field
    assert words in str(refused.value)


def test_a_sample_is_checked_and_named_by_its_place() -> None:
    [(job, places), (_, other)] = samples(changed(questions=3, together=True))
    assert len(names(job)) == 1  # one of the three: whether the network has all right is no matter here
    assert placed(InvalidRequest("target.ask.question", "d"), places).field == "grids.0.generate"
    assert placed(InvalidRequest("target.name", "d"), places).field == "grids.0.targets.0.name"
    assert placed(InvalidRequest("attack.method", "d"), other).field == "grids.0.attacks.1.attack.method"
    with pytest.raises(InvalidRequest, match=r"grids\.0\.generate\.kinds: no such question"):
        list(samples(changed(images=1, objects=[1, 1], kinds=["three_hop"])))


def test_stored_requests_without_questions_stay_as_they_were() -> None:
    grid = {"scenes": {"meshes": ["primitive/cube"]}, "attacks": GRID["attacks"]}
    dumped = parse({"grids": [grid]}).model_dump(mode="json")["grids"][0]
    assert "generate" not in dumped
    assert "prefer" not in dumped["selection"]
    asking = parse(GRIDS)
    assert CampaignSpec.model_validate(asking.model_dump(mode="json")) == asking


def test_a_question_that_the_network_reads_otherwise_is_not_attacked() -> None:
    found = views(parse(GRIDS))
    right = {
        view.number: FirstAnswer(
            view=view.number,
            label=question.answer,
            confidence=0.1 * (1 + view.number),
            truth=[str(question.answer)],
            tasks=programs(question),
        )
        for view in found
        for question in questions(view.member)
        if question.program is not None
    }
    other = right[1].model_copy(update={"tasks": right[0].tasks})
    chosen = choose(found, right | {1: other})
    assert [view.chosen for view in chosen] == [True, False, True, True]
    assert "another program" in chosen[1].why
    assert chosen[0].asked == [questions(found[0].member)[0].question]


def test_the_first_listed_are_taken_whatever_their_confidence() -> None:
    grid = GRID | {"selection": {"prefer": "listed", "most": 2}}
    found = views(parse({"grids": [grid]}))
    answers = {
        view.number: FirstAnswer(
            view=view.number,
            label="yes",
            confidence=0.1 * (1 + view.number),
            truth=["yes"],
            tasks=programs(*questions(view.member)),
        )
        for view in found
        if view.number != 1
    }
    wrong = answers[0].model_copy(update={"view": 1, "label": "no"})
    chosen = choose(found, answers | {1: wrong})
    assert [view.chosen for view in chosen] == [True, False, True, False]
    assert chosen[3].why == "there are 2 earlier views"


def test_right_answers_are_attacked_and_a_stopped_run_goes_on(tmp_path: Path) -> None:
    """The network says the same to all questions, so it is right where that is the answer; the others stay out."""
    count = 0

    def stop() -> bool:
        nonlocal count
        count += 1
        return count > 12  # in the middle of the first job

    with answering(right_at_times()):
        with pytest.raises(Cancelled):
            run_campaign(parse(GRIDS), tmp_path, LIBRARY, cancelled=stop)
        found = run_campaign(parse(GRIDS), tmp_path, LIBRARY)
    right = [question.answer == commonest() for question in asked()]
    assert any(right)
    assert not all(right)
    assert [view.chosen for view in found.views] == right
    image, colour = found.table.cells
    assert (image.success.of, colour.success.of) == (sum(right),) * 2
    assert image.success.count > 0
    own = list(results(tmp_path).values())
    assert len(own) == 2 * sum(right)
    for result in own:
        [question] = result.tasks["questions"].questions
        assert [question.right] == result.verdict.truth == [commonest()]
        assert result.spec["scene"]["source"]["record"] is not None  # type: ignore[index]
    assert {one.spec["attack"]["renderer"] for one in own} == {"image", COLOUR["renderer"]}  # type: ignore[index]


def test_questions_together_of_which_one_is_wrong_are_refused_as_a_view(tmp_path: Path) -> None:
    campaign = changed(images=1, questions=2, together=True)
    known = {one.question: one.program for one in questions(campaign.grids[0].members()[0])}
    with answering(right_at_times(), known):
        found = run_campaign(campaign, tmp_path, LIBRARY)
    [view] = found.views
    assert not view.chosen
    assert "gets it wrong before" in view.why
    assert found.table.cells == []
