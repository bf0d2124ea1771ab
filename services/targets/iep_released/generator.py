"""The published program generator: an LSTM reads a question, and another writes its program in prefix order."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from services.questions.program import MAX_NODES


class ProgramGenerator(nn.Module):
    """Maps the numbers of a question's tokens to those of its program's; names as in the published weights.

    words, functions: sizes of the vocabularies. embedding, hidden, layers: 300, 256 and 2 as published.
    """

    def __init__(self, words: int, functions: int, embedding: int, hidden: int, layers: int):
        super().__init__()
        self.encoder_embed = nn.Embedding(words, embedding)
        self.encoder_rnn = nn.LSTM(embedding, hidden, layers, batch_first=True)
        self.decoder_embed = nn.Embedding(functions, embedding)
        self.decoder_rnn = nn.LSTM(embedding + hidden, hidden, layers, batch_first=True)
        self.decoder_linear = nn.Linear(hidden, functions)

    @torch.no_grad()
    def write(self, question: Sequence[int], start: int, arities: Sequence[int | None]) -> list[int]:
        """Returns the likeliest tokens, one after another, until the program is complete.

        question: with the tokens of start and end. start: the token before the first. arities: the number of inputs of
        each token's function; None for a token that is no function, after which the program ends early. A program that
        has no end is cut off after MAX_NODES tokens.
        """
        read = self.encoder_rnn(self.encoder_embed(self._token(*question)))[0][:, -1:]
        before, state = start, None
        missing, written = 1, list[int]()
        while missing and len(written) < MAX_NODES:
            taken = torch.cat([read, self.decoder_embed(self._token(before))], dim=2)
            output, state = self.decoder_rnn(taken, state)
            before = int(self.decoder_linear(output[0, 0]).argmax())
            arity = arities[before]
            if arity is None:
                break
            written.append(before)
            missing += arity - 1
        return written

    def _token(self, *numbers: int) -> Tensor:
        return torch.tensor([numbers], device=self.encoder_embed.weight.device)
