"""A plug-in of one file with a task of its own: a network that gives a map [B, 1, h, w] in place of scores.

It is asked whether it still sees something in a share of the pixels. Its raw outputs stay here: what attacks, the
verifier and the tables see are the scores of two answers that follow from them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import Field

from scene_attack.plugin import Ask, Member, Part, ResultPart, TargetInfo, register_target, register_task

if TYPE_CHECKING:
    import torch

INTERFACE = 1
LABELS = ("seen", "gone")
SHARPNESS = 200.0
"""Steepness of the map over the difference of a pixel from mid-grey."""
CARD = TargetInfo(
    name="grey-segmenter",
    title="What is not grey",
    task="segmentation",
    input_size=(32, 32),
    classes=2,
    differentiable=True,
    source="written for a test",
    licence="Apache-2.0",
    example="0.05",
)


class Look(Ask):
    """What a segmenter is asked."""

    share: Annotated[float, Field(gt=0, lt=1)] = Field(
        description="share of the pixels in which a thing counts as seen"
    )

    @property
    def names(self) -> tuple[str, ...]:
        return (f"Is something in {self.share:.0%} of the image?",)

    @property
    def name(self) -> str:
        return self.names[0]

    @classmethod
    def example(cls, target: TargetInfo, scene: Any) -> Member:
        return Member(scene, cls(share=float(target.example or 0.05)))


class Planned(Part):
    """What it may answer."""

    labels: tuple[str, ...]

    def tables(self, folder: Path | None = None) -> list[str]:
        return [f"It answers {' or '.join(self.labels)}"]


class Segmented(ResultPart):
    """The shares in which the network sees something, before and after."""

    contents: ClassVar[dict[str, str]] = {"mask.png": "where the network sees something in the attacked image"}
    template: ClassVar[Path | None] = Path(__file__).with_name("segmenter.html")
    before: float
    after: float

    def tables(self, folder: Path | None = None) -> list[str]:
        return [f"Seen in {self.before:.1%} before and in {self.after:.1%} of the image after"]


class Segmenter:
    """The network."""

    name, labels, input_size, differentiable = CARD.name, LABELS, CARD.input_size, True
    weights_sha256, backend = "0" * 64, "none"

    def outputs(self, images: torch.Tensor) -> torch.Tensor:
        """A map [B, 1, h, w] in [0,1] of images [B, H, W, 3] in [0,1]."""
        return ((images - 128 / 255).abs().amax(-1, keepdim=True) * SHARPNESS - 3).sigmoid().movedim(-1, 1)

    def asked(self, question: str) -> Asked:
        return Asked(self, float(question))

    def logits(self, images: torch.Tensor) -> torch.Tensor:
        raise ValueError("it needs a share")


class Asked:
    """The network with its share: scores [B, 2] of "seen" and "gone"."""

    name, labels, input_size, differentiable = CARD.name, LABELS, CARD.input_size, True
    weights_sha256, backend = Segmenter.weights_sha256, Segmenter.backend

    def __init__(self, network: Segmenter, share: float) -> None:
        self._network, self._share = network, share

    def logits(self, images: torch.Tensor) -> torch.Tensor:
        margin = (self._network.outputs(images).mean((1, 2, 3)) - self._share) * 20
        return margin[:, None] * margin.new_tensor([1, -1])


@register_target(CARD, lambda: LABELS)
def load(dtype: torch.dtype) -> Segmenter:  # noqa: ARG001 - the loop is float32
    return Segmenter()


class Segmentation:
    """The task of a job: a classification of two answers, of which "seen" is right, as objects are in view."""

    def __init__(self, network: Segmenter, answers: Any) -> None:
        self._network, self._answers, self.target = network, answers, answers.target

    def settle(self, original: Any, logits: Any) -> Any:
        return self._answers.settle(original, logits)

    def constraint(self, renderer: str, initial: Any) -> None:
        return None

    def plan(self) -> Planned:
        return Planned(labels=LABELS)

    def first_answers(self, original: Any, logits: Any, goal: Any) -> Any:
        return self._answers.first_answers(original, logits, goal)

    def judge(self, settled: Any, renderer: str, stored: Any, before: Any, after: Any, out: Path) -> Any:
        from PIL import Image

        first, last = (self._network.outputs(one.saved[None] / 255)[0, 0] for one in (before, after))
        Image.fromarray((last * 255).byte().numpy()).save(out / "mask.png")
        verdict, _ = self._answers.judge(settled, renderer, stored, before, after, out)
        return verdict, Segmented(before=float(first.mean()), after=float(last.mean()))


@register_task("segmentation", ask=Look, plan=Planned, result=Segmented)
def segmentation(spec: Any, network: Segmenter, asked: Any) -> Segmentation:
    """Raises InvalidRequest where no share is asked for."""
    from scene_attack.errors import InvalidRequest
    from scene_attack.runs.classification import Classification

    if spec.target.ask is None:
        raise InvalidRequest("target.ask.share", f"is required: {network.name} is asked for a share of the pixels")
    seen = network.asked(str(spec.target.ask.share))
    return Segmentation(network, Classification(seen, asked, (0,), spec.target.ask.name))
