"""A small campaign with questions, and a network that has some of them right."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any

import torch

from scene_attack.runs.campaign_plan import views
from scene_attack.runs.campaign_spec import parse
from scene_attack.runs.prepare import prepare_exactly
from scene_attack.targets import registry
from scene_attack_questions.generator import QuestionRecord
from scene_attack_questions.grid import QuestionMember
from scene_attack_questions.iep.checkpoint import Checkpoint
from scene_attack_questions.iep.target import IepTarget
from scene_attack_questions.program import Program
from tests.unit.jobs.small import LIBRARY
from tests.unit.questions.iep.seeded import INFO, favouring, generator, network

NAME = "iep-right"
GENERATE: dict[str, Any] = {"images": 4, "seed": 8, "objects": [3, 4], "kinds": ["zero_hop"], "question_seed": 2}
SMALL = {"size": [60, 80], "shadows": False}
"""Drawn at once."""
PIXELS = {"renderer": "image", "base_renderer": "pyrender", "method": "fgsm", "steps": 40}
COLOUR = {"renderer": "pyrender", "groups": ["color"], "method": "zoo", "preset": "paper-vqa", "steps": 2}
GRID: dict[str, Any] = {
    "generate": GENERATE | SMALL,
    "targets": [NAME],
    "attacks": [{"name": "image", "attack": PIXELS}, {"name": "colour", "attack": COLOUR | {"coordinates": 2}}],
    "selection": {"prefer": "listed"},
}


GRIDS = {"grids": [GRID]}


def asked() -> list[QuestionRecord]:
    """The questions of GRID, in order."""
    return [
        question
        for member in parse(GRIDS).grids[0].members()
        if isinstance(member, QuestionMember)
        for question in member.questions
    ]


@cache
def scores() -> torch.Tensor:
    """The scores [n, 28] of the seeded network for the questions of GRID."""
    with answering(IepTarget(NAME, Checkpoint(network(), generator()), "0" * 64)):
        return torch.stack([prepare_exactly(view.probe, LIBRARY).original.logits for view in views(parse(GRIDS))])


def commonest() -> str:
    """The answer that is right most often."""
    return Counter(str(question.answer) for question in asked()).most_common(1)[0][0]


@contextmanager
def answering(target: IepTarget, known: Mapping[str, Program | None] | None = None) -> Iterator[None]:
    """Registers a target, which has these programs of these questions; default: those of the questions of GRID."""
    programs = {one.question: one.program for one in asked()} if known is None else known
    generated = target.program

    def program(question: str) -> Program:
        return programs.get(question) or generated(question)

    target.program = program  # type: ignore[method-assign]
    with registry.registered(INFO.model_copy(update={"name": NAME}), target):
        yield


def right_at_times() -> IepTarget:
    """The seeded network, which narrowly gives the commonest answer to the questions of which that is right."""
    return favouring(commonest(), scores()[[question.answer == commonest() for question in asked()]])
