"""A released network of IEP as a target: an image and a question in, scores over the 28 answers out."""

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F

from services.device import describe, device
from services.errors import InvalidRequest
from services.questions.answers import ANSWERS
from services.questions.program import InvalidProgram, Program
from services.questions.written import program_in
from services.targets.iep.assembly import Question
from services.targets.iep.prefix import from_prefix
from services.targets.iep.vocabulary import MAPPED
from services.targets.iep_released.checkpoint import Released, load
from services.targets.iep_released.engine import Results
from services.targets.preprocessing import Preprocessing

PROGRAMS = 1024
"""Questions whose programs are remembered."""


class ReleasedIepTarget:
    """A frozen released network on the configured device; implements `ProgramTarget`."""

    takes_question = True
    differentiable = True
    labels = ANSWERS

    def __init__(
        self,
        name: str,
        network: Released,
        preprocessing: Preprocessing,
        weights_sha256: str,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.name = name
        self.input_size = preprocessing.input_size
        self.weights_sha256 = weights_sha256
        self._device, self._dtype, self._preprocessing = device(), dtype, preprocessing
        self._trunk = network.trunk.to(self._device, dtype)
        self._engine = network.engine.to(self._device, dtype)
        self._generator, self._vocabulary = network.generator, network.vocabulary
        self._places = torch.tensor(network.vocabulary.answer_places, device=self._device)
        self.program = lru_cache(PROGRAMS)(self._program)

    @property
    def backend(self) -> str:
        """A line that names everything that decides the bits of its scores: version, device, dtype, threads."""
        kind, where = str(self._dtype).removeprefix("torch."), describe(self._device)
        return f"torch {torch.__version__} {where} {kind} {torch.get_num_threads()} threads"

    def _program(self, question: str) -> Program:
        """Returns the program of a question; the same for every image.

        Raises InvalidRequest("question") for words that the network does not know (UnknownWord, which names the first)
        and for a question of which no program is made, InvalidProgram for a given program that is invalid.
        """
        given = program_in(question)
        if given is not None:
            return given
        known, words = self._vocabulary, self._vocabulary.encoded(question)
        written = self._generator.write(words, known.functions.index("<START>"), known.arities)
        try:
            return from_prefix([known.functions[token] for token in written])
        except InvalidProgram as error:
            said = f"no program can be made of it: what the generator wrote is invalid ({error.detail})"
            raise InvalidRequest(
                "question", f"{said}; word it as CLEVR's questions are, or give its program"
            ) from error

    def logits(self, images: Tensor, question: str | None = None) -> Tensor:
        """Returns scores [B, 28] of images [B, H, W, 3] in [0,1]; see `Target.logits`.

        Raises ValueError without a question, and as `program` does.
        """
        if question is None:
            raise ValueError(f"{self.name} needs a question")
        return self.answers(images, [question])[:, 0]

    def answers(self, images: Tensor, questions: Sequence[str]) -> Tensor:
        """Returns scores [B, Q, 28] of several questions to each image; what they share is computed once."""
        scores = self._run(images, questions).scores[:, self._places]
        scores = scores.reshape(len(images), len(questions), len(ANSWERS))
        return scores.to(images.device, torch.promote_types(self._dtype, torch.float32))

    def attention(self, images: Tensor, question: str) -> list[Tensor | None]:
        """Returns where each function's output matters to the scores, for images [B, H, W, 3] in [0,1].

        The modules have no masks. As in the paper's figures it is the norm over the channels of the gradient of the sum
        of the scores with respect to the output, here divided by its largest value: [B, 14, 14] in [0,1], float32 on
        the CPU; None for a function whose result is no set and no object. Equal parts of a program are one function.
        """
        program = self.program(question)
        places = [place for place, kind in enumerate(program.types) if kind in MAPPED]
        with torch.enable_grad():
            found = self._run(images.detach().requires_grad_(), [question])
            outputs = [of[place] for of in found.nodes for place in places]
            gradients = torch.autograd.grad(found.scores[:, self._places].sum(), outputs)
        norms = torch.stack([gradient.norm(dim=0) for gradient in gradients]).float().cpu()
        norms = norms / norms.amax(dim=(1, 2), keepdim=True).clamp_min(torch.finfo(torch.float32).tiny)
        by_place = {place: norms[number :: len(places)] for number, place in enumerate(places)}
        return [by_place.get(place) for place in range(len(program.nodes))]

    def _run(self, images: Tensor, questions: Sequence[str]) -> Results:
        programs = [self.program(question) for question in questions]
        features = self._trunk(self._input(images))
        asked = [Question(program, image) for image in range(len(images)) for program in programs]
        results: Results = self._engine(features, asked)
        return results

    def _input(self, images: Tensor) -> Tensor:
        """Returns the network's input [B, 3, h, w]: resized, kept in [0,1], then normalised."""
        how = self._preprocessing
        x = images.to(self._device, self._dtype).permute(0, 3, 1, 2)
        if tuple(x.shape[2:]) != how.input_size:
            x = F.interpolate(x, how.input_size, mode=how.resize, antialias=True).clamp(0, 1)
        mean, scale = (x.new_tensor(values)[:, None, None] for values in (how.mean, how.scale))
        return ((x - mean) / scale).flip(1) if how.channels == "bgr" else (x - mean) / scale


def read(name: str, path: Path, preprocessing: Preprocessing, dtype: torch.dtype) -> ReleasedIepTarget:
    """Returns the target of a converted file. Raises ValueError, which says why, if it is none."""
    with path.open("rb") as opened:
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
    return ReleasedIepTarget(name, load(path), preprocessing, digest, dtype)
