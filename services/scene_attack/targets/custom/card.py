"""The card of a network that a user brings, `card.json` in its folder; and the operator's lists of what cards may name:
factories and addresses. It needs no torch.
"""

import socket
from dataclasses import dataclass
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.addresses import Address, is_loopback, is_public, read
from scene_attack.options import Options
from scene_attack.targets.info import LONGEST_LABEL

Line = Annotated[str, Field(min_length=1, max_length=300)]
Label = Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)]
MAX_LABELS = 100_000
Pixels = Annotated[int, Field(ge=1, le=4096)]
Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Preprocessing(BaseModel):
    """Turns an RGB image with values in [0,1] into the input: resize, (value − mean) / std, order of channels."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    input_size: tuple[Pixels, Pixels] = Field(default=(224, 224), description="height and width of the input, pixels")
    mean: Triple = Field(default=(0.0, 0.0, 0.0), description="mean of red, green and blue, for values in [0,1]")
    std: tuple[Positive, Positive, Positive] = Field(
        default=(1.0, 1.0, 1.0), description="divisor of red, green and blue, for values in [0,1]"
    )
    resize: Literal["bilinear", "bicubic"] = Field(
        default="bilinear", description="interpolation, antialiased, where an image has another size"
    )
    channels: Literal["rgb", "bgr"] = Field(default="rgb", description="order of the input's channels")


class Card(BaseModel):
    """The facts that a model file does not contain: the labels of the scores, the preprocessing of an image, and the
    source.

    Scores are computed by exactly one of a model file in the folder, `factory` and `endpoint`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: Line | None = Field(default=None, description="a line for lists; default: the folder's name")
    labels: Annotated[tuple[Label, ...], Field(min_length=1, max_length=MAX_LABELS)] | Line = Field(
        description="the label of each score, in order: a list, the name of a text file in the folder with one label a "
        'line, or "imagenet" for the 1,000 classes of ImageNet-1k'
    )
    preprocessing: Preprocessing = Field(
        default=Preprocessing(), description="how an image becomes the network's input"
    )
    output: Literal["scores", "probabilities"] = Field(
        default="scores",
        description="what the network returns: scores before the softmax, or probabilities, of which the logarithm is "
        "taken",
    )
    licence: Line = Field(default="not stated", description="the licence of the weights")
    source: Line = Field(default="not stated", description="where the weights come from")
    architecture: Line | None = Field(
        default=None, description="for model.safetensors: the registered architecture whose weights these are"
    )
    factory: Line | None = Field(
        default=None,
        pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$",
        description="module:callable that returns the network; it must be among SCENE_ATTACK_TARGET_FACTORIES",
    )
    endpoint: Line | None = Field(
        default=None, description="URL that answers with scores; it must be among SCENE_ATTACK_TARGET_ENDPOINTS"
    )


@dataclass(frozen=True)
class AllowList:
    """The factories, the URLs and the private addresses that cards may name."""

    factories: frozenset[str] = frozenset()
    endpoints: frozenset[str] = frozenset()

    @classmethod
    def of(cls, options: Options) -> Self:
        """The lists in the options."""
        return cls(options.allowed_factories, options.allowed_endpoints)

    def factory_refusal(self, factory: str) -> str | None:
        """Returns the reason for which a card may not name this factory; None if it may."""
        if factory in self.factories:
            return None
        return f"the factory {factory!r} is not allowed; the operator lists it in SCENE_ATTACK_TARGET_FACTORIES"

    def endpoint_refusal(self, endpoint: str) -> str | None:
        """Returns the reason for which a card may not name this URL; None if it may. Asks no name server."""
        if endpoint not in self.endpoints:
            return f"the endpoint {endpoint!r} is not allowed; the operator lists it in SCENE_ATTACK_TARGET_ENDPOINTS"
        try:
            url = urlsplit(endpoint)
            host = url.hostname or ""
        except ValueError as error:
            return f"the endpoint {endpoint!r} is no URL: {error}"
        if url.username or url.password or url.fragment:
            return "the endpoint has a user name, a password or a fragment; leave them out"
        if url.scheme == "https" and host:
            return None
        if url.scheme == "http" and is_loopback(host):
            return None
        return f"the endpoint {endpoint!r} is neither https nor on this machine"

    def resolve(self, host: str, port: int) -> str:
        """Returns an IP address of the host of a URL that may be connected to.

        An address that is not public is allowed if the URL names it itself, or the list does. Connect to the returned
        address, not to the name: another look-up may give another address. Raises OSError if there is none.
        """
        for *_, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
            if self._allowed(host, read(str(place[0]))):
                return str(place[0])
        raise OSError(f"{host} has no address that is public or listed in SCENE_ATTACK_TARGET_ENDPOINTS")

    def _allowed(self, host: str, address: Address) -> bool:
        named = host == str(address) or (host == "localhost" and address.is_loopback)
        return is_public(address) or named or str(address) in self.endpoints


NOTHING = AllowList()
"""The lists of an operator who allows nothing."""
