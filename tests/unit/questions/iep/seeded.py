"""IEP with seeded random weights, a real network, and a generator that was taught a few questions."""

from functools import cache

import torch
from torch.nn import functional as F

from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.card import CARD
from scene_attack_questions.iep.checkpoint import Checkpoint
from scene_attack_questions.iep.engine import Network
from scene_attack_questions.iep.program_generator import TOKENS, ProgramGenerator, to_prefix
from scene_attack_questions.iep.target import IepTarget
from scene_attack_questions.program import Node, Program
from scene_attack_questions.text import encoded

N_STEPS = 60


def program(*calls: str) -> Program:
    """The program of calls like "scene", "filter_color 0 red", "union 1 2"."""
    nodes = []
    for call in calls:
        name, *rest = call.split()
        inputs = tuple(int(one) for one in rest if one.isdecimal())
        nodes.append(Node(name, inputs, tuple(one for one in rest if not one.isdecimal())))
    return Program(tuple(nodes))


COUNT = program("scene", "count 0")
SAME = program("scene", "filter_color 0 red", "unique 1", "relate 2 left", "filter_shape 3 cube", "exist 4")
TAUGHT = {"How many things are there?": COUNT, "Is there a cube to the left of the red thing?": SAME}
INFO = CARD.model_copy(update={"name": "iep-seeded", "example": "How many things are there?"})


def network(seed: int = 0) -> Network:
    """A network with random weights, whose normalisation has statistics of its own as after training."""
    torch.manual_seed(seed)
    made = Network(48)
    with torch.no_grad():
        made.trunk.train()(torch.rand(2, 240, 320, 3, generator=torch.Generator().manual_seed(1)))
    return made.requires_grad_(False).eval()


@cache
def generator() -> ProgramGenerator:
    """A generator that knows the programs of TAUGHT."""
    torch.manual_seed(3)
    made = ProgramGenerator()
    optimiser = torch.optim.Adam(made.parameters(), 1e-2)
    for _ in range(N_STEPS):
        loss = torch.zeros(())
        for question, known in TAUGHT.items():
            tokens = torch.tensor([[TOKENS.index(token) for token in to_prefix(known)]])
            loss = loss + F.cross_entropy(made([encoded(question)], tokens)[0], tokens[0])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return made.requires_grad_(False).eval()


@cache
def target() -> IepTarget:
    """The target "iep-seeded"; its card is INFO."""
    return IepTarget(INFO.name, Checkpoint(network(), generator()), "0" * 64)


def favouring(said: str, scores: torch.Tensor, margin: float = 0.02) -> IepTarget:
    """The network, in which an answer is a little likelier than all others, given its scores [n, 28] of n questions."""
    own, made = ANSWERS.index(said), network()
    with torch.no_grad():
        bias = made.engine.classifier[-1].bias
        assert isinstance(bias, torch.Tensor)
        bias[own] += float((scores.amax(dim=1) - scores[:, own]).max()) + margin
    return IepTarget("iep-right", Checkpoint(made, generator()), "1" * 64)
