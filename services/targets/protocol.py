"""What an attack needs of a network."""

from typing import Protocol

from torch import Tensor


class Target(Protocol):
    """A network that turns pictures (and, for some, a question) into scores for a fixed list of labels."""

    name: str
    labels: tuple[str, ...]
    input_size: tuple[int, int]
    differentiable: bool
    takes_question: bool
    weights_sha256: str
    backend: str

    def logits(self, images: Tensor, question: str | None = None) -> Tensor:
        """Unnormalised scores [B, K], float32.

        `images` [B, H, W, 3] in [0,1] of any size: resized to `input_size` (antialiased bilinear) and normalised here.
        Differentiable with respect to `images` where `differentiable` is true. One image's scores never depend on the
        others in the batch.
        """
        ...
