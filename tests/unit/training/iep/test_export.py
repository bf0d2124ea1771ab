from collections.abc import Sequence
from random import Random

import numpy as np
import pytest
import torch
from torch import Tensor

from scene_attack.analysis.verdict import wilson
from scene_attack.errors import InvalidRequest
from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.assembly import Question, assemble
from scene_attack_questions.iep.checkpoint import Checkpoint
from scene_attack_questions.iep.engine import Network
from scene_attack_questions.program import Node, Program
from tests.unit.questions.iep import world
from training.iep import export
from training.iep.data import shard
from training.iep.examples import Example
from training.iep.export import Outcome, answered, by_family, disagreements, figures


class Known:
    """Writes the programs that it was given, and none for other questions."""

    def __init__(self, programs: dict[str, Program]) -> None:
        self._programs = programs

    def generate(self, questions: Sequence[str]) -> list[Program | InvalidRequest]:
        return [self._programs.get(text, InvalidRequest("question", "unknown")) for text in questions]


def test_answers_are_those_of_the_programs_that_were_made_of_the_texts(monkeypatch: pytest.MonkeyPatch) -> None:
    from scene_attack_questions.clevr.generator import generate

    monkeypatch.setattr(export, "AT_ONCE", 2)
    torch.manual_seed(0)
    network = Network().eval().requires_grad_(False)
    random = Random(4)
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
    images = [noise, 255 - noise // 8, np.zeros_like(noise)]
    of = shard([generate(1, k) for k in range(3)], [], images)
    examples, programs = [], {}
    for number in range(9):
        program, _ = world.question(random, world.scene(random), world.FAMILIES[number % 8])
        examples.append(Example(number // 3, f"question {number}", program, ("yes",), "some"))
        if number != 4:
            programs[f"question {number}"] = program
    found = answered(Checkpoint(network, Known(programs)), of, examples)  # type: ignore[arg-type]
    assert found[4] == (None, None)
    for example, (answer, program) in zip(examples, found, strict=True):
        if answer is not None:
            alone = _scores(network, images[example.image], example.program)
            assert answer == ANSWERS[int(alone.argmax())]
            assert program == example.program
    assert len({answer for answer, _ in found}) > 2
    first = [ANSWERS[int(_scores(network, images[0], one.program).argmax())] for one in examples]
    assert any(found[k][0] not in (None, first[k]) for k in (3, 5))  # of the second image


def _scores(network: Network, image: np.ndarray, program: Program) -> Tensor:
    return network(torch.from_numpy(image)[None].float() / 255, assemble([Question(program)])).scores[0]


def _outcomes() -> list[Outcome]:
    program = world.question(Random(0), world.scene(Random(0)), "count")[0]
    made = []
    for k in range(40):
        family = "exist" if k % 4 else "count"
        example = Example(0, "", program, ("yes",), family)
        group, renderer = ("3-10", "torch") if k < 10 else ("3-6", "pyrender")
        made.append(Outcome(example, group, renderer, right=k % 5 > 0, program_right=k != 7))
    return made


def test_figures_are_shares_with_wilson_intervals() -> None:
    found = figures(_outcomes())
    assert list(found["answers"]) == ["3-6", "3-10"]
    overall = found["answers"]["3-6"]["overall"]
    assert (overall["right"], overall["of"]) == (24, 30)
    assert tuple(overall["wilson"]) == wilson(24, 30)
    assert found["answers"]["3-10"]["count"]["of"] == 3
    assert found["answers"]["3-10"]["count"]["right"] == sum(k % 5 > 0 for k in (0, 4, 8))
    assert found["by_renderer"]["torch"]["right"] == 8
    assert found["programs"] == {"right": 39, "of": 40, "share": 39 / 40, "wilson": list(wilson(39, 40))}


def test_shares_outside_the_committed_intervals_disagree() -> None:
    committed, found = figures(_outcomes()), figures(_outcomes())
    assert disagreements(found, committed) == []
    found["answers"]["3-6"]["overall"]["share"] = committed["answers"]["3-6"]["overall"]["wilson"][0] - 0.001
    del found["by_renderer"]["torch"]
    said = disagreements(found, committed)
    assert [line.split(" is ")[0] for line in said] == ["by_renderer torch", "answers 3-6 overall"]


COUNT = Program((Node("scene", (), ()), Node("filter_size", (0,), ("small",)), Node("count", (1,), ())))
EXIST = Program((Node("scene", (), ()), Node("exist", (0,), ())))


def test_shares_are_counted_by_family() -> None:
    examples = [
        Example(0, "", program, (), family)
        for program, family in ((COUNT, "count"), (COUNT, "count"), (COUNT, "count"), (EXIST, "exist"))
    ]
    families = by_family(examples, [True, False, True, False])
    assert {name: (one.right, one.of) for name, one in families.items()} == {
        "overall": (2, 4),
        "count": (2, 3),
        "exist": (0, 1),
    }
    assert families["count"].share == pytest.approx(2 / 3)
    assert families["count"].interval == wilson(2, 3)
