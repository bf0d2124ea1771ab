"""What an attack needs of a network."""

from typing import Protocol

from torch import Tensor


class Target(Protocol):
    """A network that turns images (and, for some, a question) into scores for a fixed list of labels."""

    @property
    def name(self) -> str:
        """The word of the request."""
        ...

    @property
    def labels(self) -> tuple[str, ...]:
        """One per score, unique."""
        ...

    @property
    def input_size(self) -> tuple[int, int]:
        """Height and width of the images it was trained on."""
        ...

    @property
    def differentiable(self) -> bool:
        """Whether gradients reach the input."""
        ...

    @property
    def takes_question(self) -> bool:
        """Whether `logits` needs a question."""
        ...

    @property
    def weights_sha256(self) -> str:
        """Of the file the weights came from."""
        ...

    @property
    def backend(self) -> str:
        """Everything that decides the bits of the output: versions, driver, dtype, threads."""
        ...

    def logits(self, images: Tensor, question: str | None = None) -> Tensor:
        """Unnormalised scores [B, K], float32, on the device of the images.

        `images` [B, H, W, 3] in [0,1], on any device and of any size: resized to `input_size` (antialiased bilinear)
        and normalised here. Differentiable with respect to `images` where `differentiable` is true. One image's scores
        never depend on the others in the batch.
        """
        ...
