"""Questions in requests: what is refused, what is filled in, and jobs that attack an answer to the verdict."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from safetensors.torch import load_file

from scene_attack.analysis.images import answer as network_answer
from scene_attack.errors import InvalidRequest
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import Prepared, prepare, prepare_exactly
from scene_attack.runs.preview import preview
from scene_attack.runs.spec import JobSpec, digest, parse
from scene_attack.targets import registry
from scene_attack_questions.ask import Questions
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.executor import ANSWERS, KINDS, Facts, answer
from scene_attack_questions.iep.target import IepTarget
from scene_attack_questions.parts import QuestionsPlan
from scene_attack_questions.records import ATTENTION, Asked
from scene_attack_questions.source import Clevr
from tests.unit.jobs.small import LIBRARY, SPHERE
from tests.unit.questions.iep.seeded import INFO, TAUGHT, favouring, program, target
from tests.unit.questions.question_requests import ATTACK, RECORD, asking, calls

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _seeded() -> Iterator[None]:
    with registry.registered(INFO, target()):
        yield


def test_a_record_or_a_seed_becomes_a_scene_with_its_record() -> None:
    source = {"format": "clevr", "record": RECORD.model_dump(mode="json", by_alias=True)}
    given = parse({"scene": {"source": source}})
    made = parse({"scene": {"source": {"format": "clevr", "generate": {"seed": 8, "index": 2, "objects": 4}}}})
    for spec in (given, made):
        assert spec.scene.source == Clevr(format="clevr", record=RECORD)
        assert spec.scene.model_copy(update={"source": None}) == describe(RECORD)
    # the stored request is the same request
    again = JobSpec.model_validate(json.loads(made.model_dump_json()))
    assert again == made
    assert digest(again) == digest(made) == digest(given)


def test_a_part_of_the_scene_may_be_stated_and_the_rest_follows() -> None:
    source = {"format": "clevr", "record": RECORD.model_dump(mode="json")}
    spec = parse({"scene": {"source": source, "camera": {"size": [120, 160]}, "shadows": None}})
    assert spec.scene.camera == describe(RECORD, (120, 160)).camera
    assert spec.scene.shadows is None
    assert spec.scene.objects == describe(RECORD).objects


def test_clevr_s_generator_s_words_for_a_program_are_read() -> None:
    written = [{"type": "scene", "inputs": []}, {"type": "filter_color", "inputs": [0], "side_inputs": ["red"]}]
    spec = parse(asking([*written, {"type": "count", "inputs": [1]}]))
    assert spec == parse(asking(calls("scene", "filter_color 0 red", "count 1")))
    assert JobSpec.model_validate(spec.model_dump(mode="json")) == spec


def test_requests_without_questions_keep_their_canonical_json() -> None:
    spec = parse({"scene": SPHERE})
    assert spec.model_dump(mode="json").keys() == {"scene", "target", "goal", "attack", "tolerance", "analysis", "seed"}
    assert spec.goal.model_dump(mode="json").keys() == {"truth", "leave", "reach", "least_confidence"}
    assert spec.model_dump(mode="json")["target"] == {"name": "efficientnet-lite0"}


def right(lines: list[str]) -> str:
    return answer(program(*lines), Facts.of(RECORD))


def right_of(said: str, *asked: Any) -> IepTarget:
    """The seeded network, which answers so to questions about the original."""
    return favouring(said, torch.stack([prepare_exactly(parse(asking(one)), LIBRARY).original.logits for one in asked]))


def stated(prepared: Prepared) -> tuple[Asked, ...]:
    part = prepared.task.plan()
    assert isinstance(part, QuestionsPlan)
    return part.questions


def questions_of(data: Any) -> Questions:
    ask = parse(data).target.ask
    assert isinstance(ask, Questions)
    return ask


LARGE = ["scene", "filter_size 0 large", "count 1"]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Any]:
    """Runs a job on the network that has the question right before the attack."""
    large = calls(*LARGE)
    info = INFO.model_copy(update={"name": "iep-right"})
    with registry.registered(info, right_of(right(LARGE), large)):

        def job(**changes: Any) -> Any:
            data = asking(large, **changes)
            data["target"]["name"] = "iep-right"
            return execute(parse(data), tmp_path, LIBRARY)

        yield job


def shown(path: Path) -> torch.Tensor:
    with Image.open(path) as image:
        pixels = torch.frombuffer(bytearray(image.tobytes()), dtype=torch.uint8).view(1, 60, 80, 3)
    return pixels / 255


def test_a_right_answer_is_attacked_to_the_verdict(run: Any, tmp_path: Path) -> None:
    result = run(attack=ATTACK | {"steps": 40})
    [found] = result.tasks["questions"].questions
    assert result.verdict.truth == [right(LARGE)] == [found.right] == [found.before.label]
    assert result.verdict.right_before
    assert (result.outcome, found.outcome, result.verified) == ("fooled", "fooled", True)
    assert found.after.label == result.attacked.label != found.before.label
    assert (found.kind, found.before_of_kind) == ("integer", True)
    assert found.after_of_kind == (found.after.label in KINDS["integer"])
    assert found.right_after == found.right
    assert found.program == calls(*LARGE)
    # the stored image has the stored answer
    own, question = registry.load("iep-right"), questions_of(result.spec).texts[0]
    assert isinstance(own, IepTarget)
    assert question is not None
    assert (
        own.labels[int(own.asked(question).logits(shown(tmp_path / "attacked.png"))[0].argmax())] == found.after.label
    )
    # and its attention
    masks = load_file(tmp_path / ATTENTION)
    attended = own.attention(shown(tmp_path / "attacked.png"), question)
    assert [one.node for one in found.attention] == [0, 1]
    for one in found.attention:
        expected = attended[one.node]
        assert expected is not None
        assert torch.equal(masks[f"0.{one.node}.after"], expected[0])
        with Image.open(tmp_path / one.after) as image:
            assert image.size == (320, 240)
            assert image.getpixel((16 * 3 + 5, 16 * 2 + 5)) == (round(255 * float(expected[0, 2, 3])),) * 3
        before, now = (masks[f"0.{one.node}.{when}"].flatten().tolist() for when in ("before", "after"))
        changes = [abs(a - b) for a, b in zip(now, before, strict=True)]
        assert (one.change, one.cell_change) == pytest.approx((sum(changes), max(changes)), rel=1e-12)


def test_leaving_the_kind_of_answers(run: Any) -> None:
    result = run(leave_kind=True, attack=ATTACK | {"steps": 60})
    assert set(result.verdict.labels_to_leave) == set(KINDS["integer"])
    [found] = result.tasks["questions"].questions
    assert result.outcome == ("fooled" if found.after.label not in KINDS["integer"] else "held")
    assert found.after_of_kind == (result.outcome == "held")
    assert questions_of(result.spec).leave_kind


def test_scenes_are_attacked_within_what_exists(run: Any, tmp_path: Path) -> None:
    attack = {"renderer": "pyrender", "method": "zoo", "preset": "paper-vqa", "steps": 2, "coordinates": 60}
    result = run(attack=attack)
    moved = load_file(tmp_path / "perturbation.safetensors")
    assert moved["illumination"].shape == (13,)
    assert moved["illumination"][0] == 0
    assert not moved["translation"][:, 1].any()
    assert not moved["rotation"][:, [0, 2]].any()
    assert moved["translation"][:, 0].any()
    assert result.spec["attack"]["delta"] == 1e-3
    listed = {item.part: (item.kept, item.of) for item in result.plan.items if item.part in moved}
    assert listed == {"illumination": (12, 13), "color": (12, 12), "translation": (8, 12), "rotation": (4, 12)}
    assert result.tasks["questions"].questions[0].right_after == result.tasks["questions"].questions[0].right


def test_what_cannot_reach_the_answer_is_left_out_and_listed(run: Any, tmp_path: Path) -> None:
    attack = {"renderer": "pyrender", "method": "zoo", "preset": "paper-vqa", "steps": 2, "coordinates": 60}
    attack |= {"groups": ["color", "rotation"], "leave_out": {"color": 1e-9, "rotation": 1e-9}}
    result = run(attack=attack)
    measured = result.measured.settings["leave_out"]
    # nothing is said of the turns that stay: they are not measured
    assert len(measured["effects"]) == 12 + 4
    assert {name.split()[-1] for name in measured["effects"] if "rotation" in name} == {"y"}
    # so small moves of all change the advantage by less than 1 % of it
    assert sum(measured["effects"].values()) <= 0.01 * measured["advantage"]
    assert len(measured["left_out"]) == 12 + 4 - 1  # all that is free but the most effective
    listed = {item.part: item for item in result.plan.items if item.what == "coordinates that reach the answer"}
    assert {part: one.of for part, one in listed.items()} == {"color": 12, "rotation": 4}
    assert sum(one.kept for one in listed.values()) == 1
    for part, one in listed.items():
        left = [name for name in measured["left_out"] if part in name]
        assert one.of - one.kept == len(left)
        assert one.why.endswith(f"together: {', '.join(left) or 'none is left out'}")
    assert all(name in listed["color"].why + listed["rotation"].why for name in measured["left_out"])
    moved = load_file(tmp_path / "perturbation.safetensors")
    assert sum(int(value.count_nonzero()) for value in moved.values()) <= 1


def test_groups_of_many_coordinates_are_not_measured() -> None:
    attack = ATTACK | {"method": "zoo", "leave_out": {"image": 0.1}}
    with pytest.raises(InvalidRequest, match="too many coordinates") as refused:
        prepare(parse(asking(calls(*LARGE), attack=attack)), LIBRARY)
    assert refused.value.field == "attack.leave_out.image"


def test_the_verdict_uses_the_truth_of_the_attacked_scene(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer that follows a change of the scene is right, whatever was right before."""
    before = run(attack=ATTACK | {"steps": 40})
    answered = before.tasks["questions"].questions[0].after.label
    monkeypatch.setattr("scene_attack_questions.task.AskedQuestion.right_after", lambda *_: answered)
    after = run(attack=ATTACK | {"steps": 40})
    assert after.tasks["questions"].questions[0].after.label == answered
    assert (before.outcome, after.outcome) == ("fooled", "held")


AGAIN = ["scene", "filter_size 0 large", "filter_size 1 large", "count 2"]


def test_several_questions_are_attacked_together(tmp_path: Path) -> None:
    both = [calls(*LARGE), calls(*AGAIN)]
    own = right_of(right(LARGE), *both)
    with registry.registered(INFO.model_copy(update={"name": "iep-right"}), own):
        data = asking(None, attack=ATTACK | {"steps": 60})
        data["target"] = {"name": "iep-right", "ask": {"questions": both}}
        result = execute(parse(data), tmp_path, LIBRARY)
        scores = own.answers(shown(tmp_path / "attacked.png"), questions_of(data).texts)[0]
    found = result.tasks["questions"].questions
    assert [ANSWERS[int(one.argmax())] for one in scores] == [one.after.label for one in found]
    outcomes = [one.outcome for one in found]
    assert outcomes == [("fooled" if one.after.label != one.right else "held") for one in found]
    assert result.outcome == ("fooled" if set(outcomes) == {"fooled"} else "held")
    assert result.verified == (result.outcome == "fooled")
    assert result.outcome == "fooled"
    assert {one.name for one in tmp_path.glob("attention-1-*.png")} == {
        name for one in found[1].attention for name in (one.before, one.after)
    }


def test_a_preview_answers_each_of_several_questions() -> None:
    both = [calls(*LARGE), calls(*AGAIN)]
    with registry.registered(INFO.model_copy(update={"name": "iep-right"}), right_of(right(LARGE), *both)):
        data = asking(None)
        data["target"] = {"name": "iep-right", "ask": {"questions": both}}
        found, _ = preview(parse(data), LIBRARY)
    assert [one.asked for one in found.answers] == list(questions_of(data).texts)
    assert [one.answer.label for one in found.answers] == [right(LARGE)] * 2


def test_only_a_question_and_a_renderer_that_moves_objects_limit_the_search() -> None:
    moving = {"attack": {"renderer": "pyrender", "groups": ["translation"]}}
    spec, alone = parse(asking(calls(*LARGE)) | moving), parse({"scene": SPHERE} | moving)
    assert prepare_exactly(spec, LIBRARY).constraint is not None
    assert prepare_exactly(alone, LIBRARY).constraint is None
    assert prepare_exactly(parse(asking(calls(*LARGE)) | {"attack": {"renderer": "torch"}}), LIBRARY).constraint is None


def test_words_are_asked_as_their_program() -> None:
    for words, known in TAUGHT.items():
        try:
            expected = answer(known, Facts.of(RECORD))
        except InvalidRequest:
            continue
        prepared = prepare_exactly(parse(asking(words)), LIBRARY)
        assert [question.program for question in stated(prepared)] == [known.written()]
        assert prepared.settled.truth == (ANSWERS.index(expected),)
        assert network_answer(prepared.original.logits, ANSWERS, prepared.settled.goal).label in ANSWERS
