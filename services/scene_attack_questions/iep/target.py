"""IEP as a target: an image and a question in, scores over the 28 answers out.

The question fixes the program: one in words is turned into it by the program generator, which sees no image, so that
all images of an attack are asked the same. A question may be a program itself (`scene_attack_questions.program`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional as F

from scene_attack.errors import InvalidRequest
from scene_attack.process import describe, device
from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.assembly import MAPPED, Question, assemble
from scene_attack_questions.iep.checkpoint import HOW_TO_GET_WEIGHTS, Checkpoint, load
from scene_attack_questions.iep.engine import IMAGE
from scene_attack_questions.program import InvalidProgram, Program, program_in

if TYPE_CHECKING:
    from scene_attack_questions.iep.engine import Execution

PROGRAMS = 1024
"""Number of questions whose programs are remembered."""


@dataclass(frozen=True)
class Asked:
    """A network with its question; implements `Target`."""

    network: IepTarget
    question: str
    differentiable: bool = field(default=True, init=False)
    labels: tuple[str, ...] = field(default=ANSWERS, init=False)
    input_size: tuple[int, int] = field(default=IMAGE, init=False)

    @property
    def name(self) -> str:
        """The network's name."""
        return self.network.name

    @property
    def weights_sha256(self) -> str:
        """SHA-256 (hex) of the network's weights file."""
        return self.network.weights_sha256

    @property
    def backend(self) -> str:
        """The network's backend."""
        return self.network.backend

    def logits(self, images: Tensor) -> Tensor:
        """Returns scores [B, 28] of images [B, H, W, 3] in [0,1]; see `Target.logits`. Raises as `program` does."""
        return self.network.answers(images, [self.question])[:, 0]


class IepTarget:
    """A frozen network with the generator of its programs on the configured device; implements `ProgramTarget`."""

    differentiable = True
    labels = ANSWERS
    input_size = IMAGE

    def __init__(
        self, name: str, checkpoint: Checkpoint, weights_sha256: str, dtype: torch.dtype = torch.float32
    ) -> None:
        self.name = name
        self.weights_sha256 = weights_sha256
        self._device, self._dtype = device(), dtype
        self._network = checkpoint.network.to(self._device, dtype).eval().requires_grad_(False)
        self._generator = checkpoint.generator.eval().requires_grad_(False)
        self.program = lru_cache(PROGRAMS)(self._program)

    @property
    def backend(self) -> str:
        """A line that names everything that decides the bits of its scores: version, device, dtype, threads."""
        kind, where = str(self._dtype).removeprefix("torch."), describe(self._device)
        return f"torch {torch.__version__} {where} {kind} {torch.get_num_threads()} threads"

    def _program(self, question: str) -> Program:
        """Returns the program of a question; the same for every image.

        Raises InvalidRequest("question") for words outside the language (UnknownWord, which names the first) and for a
        question in words of which no program can be made, InvalidProgram for a program that is invalid.
        """
        program = program_in(question)
        if program is not None:
            return program
        (generated,) = self._generator.generate([question])
        if isinstance(generated, InvalidProgram):
            reason = f"no program can be made of it: what the generator wrote is invalid ({generated.detail})"
            raise InvalidRequest("question", f"{reason}; word it as CLEVR's questions are, or give its program")
        if isinstance(generated, InvalidRequest):
            raise generated
        return generated

    def asked(self, question: str) -> Asked:
        """Returns the network with this question."""
        return Asked(self, question)

    def logits(self, images: Tensor) -> Tensor:  # noqa: ARG002 - the protocol's
        """Raises ValueError: without a question it has no scores."""
        raise ValueError(f"{self.name} needs a question")

    def answers(self, images: Tensor, questions: Sequence[str]) -> Tensor:
        """Returns scores [B, Q, 28] of several questions to each image; shared subprograms are computed once."""
        scores = self._run(images, questions).scores.reshape(len(images), len(questions), len(ANSWERS))
        return scores.to(images.device, torch.promote_types(self._dtype, torch.float32))

    @torch.no_grad()
    def attention(self, images: Tensor, question: str) -> list[Tensor | None]:
        """Returns the attention masks of the functions of the question's program in images [B, H, W, 3] in [0,1].

        For each node, in the program's order, its mask [B, 15, 20] in [0,1], float32 on the CPU, high where an object
        of the set is; None for a node whose result is no set and no object. Raises as `program` does.
        """
        execution = self._run(images, [question])
        return [
            torch.stack([execution.attention(image, node) for image in range(len(images))]).float().cpu()
            if kind in MAPPED
            else None
            for node, kind in enumerate(self.program(question).types)
        ]

    def _run(self, images: Tensor, questions: Sequence[str]) -> Execution:
        programs = [self.program(question) for question in questions]
        x = images.to(self._device, self._dtype)
        if tuple(x.shape[1:3]) != IMAGE:
            x = F.interpolate(x.permute(0, 3, 1, 2), IMAGE, mode="bilinear", antialias=True).permute(0, 2, 3, 1)
        asked = [Question(program, image) for image in range(len(images)) for program in programs]
        execution: Execution = self._network(x, assemble(asked))
        return execution


def read(name: str, path: Path, dtype: torch.dtype) -> IepTarget:
    """Returns the target of a checkpoint file.

    Raises InvalidRequest("target.name"), which says what is missing or wrong.
    """
    if not path.is_file():
        raise InvalidRequest("target.name", f"the weights of {name}, {path.name}, are not there; {HOW_TO_GET_WEIGHTS}")
    try:
        checkpoint = load(path)
    except ValueError as error:
        raise InvalidRequest("target.name", f"the weights of {name} cannot be used: {error}") from error
    return IepTarget(name, checkpoint, hashlib.sha256(path.read_bytes()).hexdigest(), dtype)
