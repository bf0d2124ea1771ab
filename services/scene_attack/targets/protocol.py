"""Defines the protocol of targets: the networks that attacks run against."""

from typing import Protocol, runtime_checkable

from torch import Tensor


class Target(Protocol):
    """A network that turns images into scores for a fixed list of labels."""

    @property
    def name(self) -> str:
        """The target's name in a request."""
        ...

    @property
    def labels(self) -> tuple[str, ...]:
        """The label of each score; labels are unique."""
        ...

    @property
    def input_size(self) -> tuple[int, int]:
        """Height and width of the network's input, pixels."""
        ...

    @property
    def differentiable(self) -> bool:
        """Whether scores are differentiable with respect to the images."""
        ...

    @property
    def weights_sha256(self) -> str:
        """SHA-256 (hex) of the weights file."""
        ...

    @property
    def backend(self) -> str:
        """A line that names everything that decides the bits of the scores: versions, device, dtype, threads."""
        ...

    def logits(self, images: Tensor) -> Tensor:
        """Returns unnormalised scores [B, K], float32 or wider, on the device of the images.

        `images` [B, H, W, 3] in [0,1], on any device and of any size; they are resized to `input_size` (antialiased
        bilinear) and normalised here. Differentiable with respect to `images` where `differentiable` is true. An
        image's scores do not depend on the other images in the batch.
        """
        ...


@runtime_checkable
class QuestionTarget(Target, Protocol):
    """A target that has scores only once it is asked something. A question is one text."""

    def asked(self, question: str) -> Target:
        """Returns the network with this question, whose `logits` are the scores of the answers."""
        ...
