"""The program generator: from the words of a question to its program, as a sequence in prefix order.

A bidirectional LSTM reads the words; an LSTM that attends to them (Luong et al. 2015) writes the functions greedily.

A program in prefix order is a sequence of functions with their values, the root first, each before its inputs. As every
function has a fixed number of inputs, the sequence has no need of brackets, and its end is known.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_padded_sequence, pad_packed_sequence

from scene_attack.errors import InvalidRequest
from scene_attack_questions.program import FUNCTIONS, MAX_NODES, InvalidProgram, Node, Program
from scene_attack_questions.text import WORDS, encoded

TOKENS = tuple(
    f"{name}[{value}]" if value else name for name, function in FUNCTIONS.items() for value in function.values or ("",)
)
"""The functions with their values."""
ARITIES = tuple(len(FUNCTIONS[token.partition("[")[0]].inputs) for token in TOKENS)
"""The number of inputs of each token."""


def to_prefix(program: Program) -> list[str]:
    """Returns a valid program's functions in prefix order. A node that several take is written once for each."""

    def written(place: int) -> list[str]:
        node = program.nodes[place]
        return [node.label, *(token for source in node.inputs for token in written(source))]

    return written(len(program.nodes) - 1)


def from_prefix(tokens: Sequence[str]) -> Program:
    """Returns the program of functions in prefix order.

    Raises InvalidProgram for an unknown function, for a sequence that ends early or goes on after the end, and for a
    program whose types do not fit.
    """
    if len(tokens) > MAX_NODES:
        raise InvalidProgram(None, "form", f"it has {len(tokens)} functions; at most {MAX_NODES} are allowed")
    nodes: list[Node] = []
    rest = list(reversed(tokens))

    def parse() -> int:
        if not rest:
            raise InvalidProgram(None, "form", f"it ends early, after {len(tokens)} functions")
        token = rest.pop()
        if token not in TOKENS:
            raise InvalidProgram(None, "function", f"there is no function {token!r}")
        function, _, value = token.removesuffix("]").partition("[")
        inputs = tuple(parse() for _ in FUNCTIONS[function].inputs)
        nodes.append(Node(function, inputs, (value,) if value else ()))
        return len(nodes) - 1

    parse()
    if rest:
        raise InvalidProgram(None, "form", f"it goes on after its end, with {rest[-1]!r}")
    program = Program(tuple(nodes))
    program.check()
    return program


EMBEDDING = 64
HIDDEN = 128
"""Size of the decoder's state; each direction of the encoder has half."""
BEGIN = len(TOKENS)
"""Index of the token before the first."""


class ProgramGenerator(nn.Module):
    """Maps questions to programs; 0.30 million parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.read = nn.Embedding(len(WORDS), EMBEDDING)
        self.encoder = nn.LSTM(EMBEDDING, HIDDEN // 2, batch_first=True, bidirectional=True)
        self.bridge = nn.Linear(HIDDEN, 2 * HIDDEN)
        self.written = nn.Embedding(len(TOKENS) + 1, EMBEDDING)
        self.decoder = nn.LSTMCell(EMBEDDING + HIDDEN, HIDDEN)
        self.query = nn.Linear(HIDDEN, HIDDEN, bias=False)
        self.output = nn.Linear(2 * HIDDEN, len(TOKENS))

    def forward(self, questions: Sequence[Sequence[int]], tokens: Tensor) -> Tensor:
        """Returns the scores [B, S, len(TOKENS)] of each token of programs.

        questions: indices of words in `WORDS`, one at least each. tokens: int64 [B, S], the true tokens; a token's
        scores depend on those before it.
        """
        reading = _Reading(self, questions)
        before = torch.cat([tokens.new_full((len(tokens), 1), BEGIN), tokens[:, :-1]], dim=1)
        return torch.stack([reading.next_scores(before[:, place]) for place in range(tokens.shape[1])], dim=1)

    @torch.no_grad()
    def generate(self, questions: Sequence[str]) -> list[Program | InvalidRequest]:
        """Returns the program of each question, or the error if there is none.

        The error is an InvalidRequest such as UnknownWord if the question cannot be encoded, or InvalidProgram if the
        sequence written for it is no program.
        """
        results: list[Program | InvalidRequest | list[int]] = [_encoded(question) for question in questions]
        legible = [place for place, result in enumerate(results) if isinstance(result, list)]
        written = self._write([results[place] for place in legible]) if legible else []  # type: ignore[misc]
        for place, tokens in zip(legible, written, strict=True):
            try:
                results[place] = from_prefix(tokens)
            except InvalidProgram as error:
                results[place] = error
        return results  # type: ignore[return-value]

    def _write(self, questions: Sequence[Sequence[int]]) -> list[list[str]]:
        """Returns the likeliest next token again and again, until each program is complete or too long."""
        reading = _Reading(self, questions)
        arities = torch.tensor(ARITIES)
        before = torch.full((len(questions),), BEGIN)
        missing = torch.ones(len(questions), dtype=torch.int64)
        written: list[list[str]] = [[] for _ in questions]
        for _ in range(MAX_NODES):
            before = reading.next_scores(before).argmax(1)
            for place in missing.nonzero()[:, 0].tolist():
                written[place].append(TOKENS[int(before[place])])
            missing = torch.where(missing > 0, missing + arities[before] - 1, missing)
            if not missing.any():
                break
        return written


def _encoded(question: str) -> list[int] | InvalidRequest:
    try:
        return encoded(question)
    except InvalidRequest as error:
        return error


class _Reading:
    """Questions that have been read, and the state of the writing of their programs."""

    def __init__(self, generator: ProgramGenerator, questions: Sequence[Sequence[int]]):
        self._generator = generator
        lengths = torch.tensor([len(question) for question in questions])
        words = nn.utils.rnn.pad_sequence([torch.tensor(question) for question in questions], batch_first=True)
        packed = pack_padded_sequence(generator.read(words), lengths, batch_first=True, enforce_sorted=False)
        read, (last, _) = generator.encoder(packed)
        self._words: Tensor = pad_packed_sequence(read, batch_first=True)[0]
        self._absent = torch.arange(words.shape[1])[None] >= lengths[:, None]
        hidden, cell = generator.bridge(torch.cat([last[0], last[1]], dim=1)).tanh().chunk(2, dim=1)
        self._state = hidden, cell
        self._context = torch.zeros_like(hidden)

    def next_scores(self, before: Tensor) -> Tensor:
        """Returns the scores [B, len(TOKENS)] of the token after `before`, int64 [B]."""
        generator = self._generator
        self._state = generator.decoder(torch.cat([generator.written(before), self._context], dim=1), self._state)
        hidden = self._state[0]
        scores = torch.bmm(self._words, generator.query(hidden)[:, :, None])[:, :, 0]
        attention = scores.masked_fill(self._absent, -torch.inf).softmax(1)
        self._context = torch.bmm(attention[:, None], self._words)[:, 0]
        result: Tensor = generator.output(torch.cat([hidden, self._context], dim=1))
        return result
