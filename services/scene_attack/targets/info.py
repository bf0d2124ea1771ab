"""Lists and registers targets. It needs no torch, so that the API can import it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from pydantic import BaseModel, Field

from scene_attack.errors import InvalidRequest
from scene_attack.plugins import Registry
from scene_attack.process import options
from scene_attack.text import there_are

if TYPE_CHECKING:
    import torch

    from scene_attack.targets.protocol import Target

Vocabulary = Literal["imagenet", "furniture-14", "clevr", "custom"]
LONGEST_LABEL = 300
"""Largest number of characters of a label, so that a goal can name every label."""


class TargetInfo(BaseModel):
    """A target's model card: its name, task, input size, source and licence. `input_size` is height and width.

    `vocabulary` says what its labels are, from which the truth of a scene follows (scene_attack.targets.labels): those
    of ImageNet-1k, the kinds of the library's furniture, the answers to questions about CLEVR's scenes, or something
    else.
    """

    name: str
    title: str
    task: str = Field("classification", description="what it is asked; 'classification', or a task of a plug-in")
    input_size: tuple[int, int]
    classes: int
    differentiable: bool | None
    """Whether scores have a gradient with respect to the image; None if that is known once the network is loaded."""
    source: str
    licence: str
    vocabulary: Vocabulary = "custom"
    example: str | None = None
    """A question that it takes, with which it is tried when it is loaded; None: any text."""
    missing: str | None = None
    """Message that the weights file is not on this machine yet, and how to get it; None if nothing is missing."""
    card_sha256: str | None = None
    """SHA-256 (hex) of the bytes of `card.json`, for a network that a user brings."""


ANY_QUESTION = "What is this?"
"""The question to a target whose card has no example of one."""


def shipped(file: str) -> Path:
    """Path of a file of weights that ships with the project."""
    return Path(__file__).with_name("weights") / file


@dataclass(frozen=True)
class Published:
    """A file of weights at its published address, which is fetched when it is first needed."""

    url: str

    @property
    def name(self) -> str:
        """The file's name."""
        return self.url.rpartition("/")[2]

    @property
    def sha256(self) -> str:
        """The beginning of its SHA-256 (hex), in which its name ends."""
        return self.name.removesuffix(".pth").rpartition("-")[2]

    @property
    def path(self) -> Path:
        """Path of the file on this machine, once it has been fetched."""
        return options().cache_dir / "weights" / self.name

    def missing(self) -> str | None:
        """Returns a message that the file is missing, and how to get it; None if it is there."""
        if self.path.exists():
            return None
        return f"its weights are not here yet; the first job fetches {self.url} into weights/ of SCENE_ATTACK_CACHE"


Load = Callable[["torch.dtype"], "Target"]
Loader = TypeVar("Loader", bound=Load)


@dataclass(frozen=True)
class RegisteredTarget:
    """A target's card, and the functions that return its labels and load it."""

    info: TargetInfo
    labels: Callable[[], tuple[str, ...]]
    load: Load
    weights: Published | None = None
    card_files: tuple[Path, ...] = ()
    """Files of a network that a user brings: its card, then the file of its labels if it has one."""
    model_file: Path | None = None
    """Its model file; None for a factory, an endpoint, and a network that somebody else brings."""


TARGETS: Registry[RegisteredTarget] = Registry("target", ["scene_attack.targets.image_networks"])

UNAVAILABLE: dict[str, str] = {}
"""Name to reason of each folder of SCENE_ATTACK_TARGETS that cannot be a target."""


def register(
    info: TargetInfo, labels: Callable[[], tuple[str, ...]], weights: Published | None = None
) -> Callable[[Loader], Loader]:
    """Returns a decorator of the function that loads a target, given its dtype. `labels` returns a label per score.

    weights: the file that it needs, if that is fetched.

    Raises ValueError for a name that is taken, and for labels that are no function.
    """
    if not callable(labels):
        raise ValueError(
            f"the labels of target {info.name!r} are a {type(labels).__name__}, not a function without arguments"
        )

    def decorate(load: Loader) -> Loader:
        TARGETS.add(info.name, RegisteredTarget(info, labels, load, weights))
        return load

    return decorate


def known(name: str) -> RegisteredTarget:
    """Returns the target of that name, which is not loaded. Raises InvalidRequest("target.name") for an unknown one."""
    if name in UNAVAILABLE:
        raise InvalidRequest("target.name", f"target {name!r} is not available: {UNAVAILABLE[name]}")
    if name not in TARGETS:
        raise InvalidRequest("target.name", f"there is no target {name!r}; {there_are(name, TARGETS)}")
    return TARGETS[name]


def available() -> list[TargetInfo]:
    """Returns the cards of all targets, each with `missing` as it is on this machine."""
    return [
        target.info.model_copy(update={"missing": None if target.weights is None else target.weights.missing()})
        for target in TARGETS.values()
    ]
