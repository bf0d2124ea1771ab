"""Signs that FGSM takes from the gradient of a network's log-odds within each tolerance, against the exact ones."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision.attack_runs import NETWORK
from services.accuracy.work_precision.shading import GROUPS, TOLERANCES
from services.rendering.color import as_saved
from services.rendering.factory import build
from services.rendering.plan import Tolerance
from services.rendering.protocol import Renderer
from services.scenes.resolve import ResolvedScene
from services.targets.registry import load
from services.targets.scores import log_odds


class SignRow(BaseModel):
    """Signs of one group's gradient through the network, as a step of FGSM takes them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    map: tuple[int, int]
    group: str
    tolerance: Tolerance
    network: str = Field(description="number type of the network")
    image: str = Field(description="what the network saw when its gradient was taken: the image, or its 8 bits")
    coordinates: int = Field(description="whose gradient is not 0")
    wrong_signs: float = Field(description="share of coordinates whose sign is wrong")
    wrong_weight: float = Field(
        description="the same, each coordinate weighted by its part of the gradient's absolute sum"
    )


def rows(mesh: str, label: str, size: tuple[int, int], texels: tuple[int, int]) -> Iterator[SignRow]:
    """The log-odds of `label` through plans for all groups at each tolerance, with the network's gradient at the
    image and at its 8 bits, as the attack's loop takes it; the reference is float64 throughout, at the image."""
    scene = placed(
        mesh, size=size, thing={"material": "glossy-paint"}, lights={"environment": {"map": "studio", "size": texels}}
    )
    number = load(NETWORK).labels.index(label)
    wanted = _gradients(_renderer(scene, "exact"), number, torch.float64, rounded=False)
    for tolerance, rounded in product(TOLERANCES, (False, True)):
        found = _gradients(_renderer(scene, tolerance), number, torch.float32, rounded)
        for group in GROUPS:
            wrong = wrong_signs(found[group], wanted[group])
            yield SignRow(
                mesh=mesh,
                map=texels,
                group=group,
                tolerance=tolerance,
                network="float32",
                image="8 bit" if rounded else "unrounded",
                coordinates=int((wanted[group] != 0).sum()),
                wrong_signs=wrong.share,
                wrong_weight=wrong.weight,
            )


def _renderer(scene: ResolvedScene, tolerance: Tolerance) -> Renderer:
    built = build(scene, "torch", groups=GROUPS, tolerance=tolerance)
    return built.exact() if tolerance == "exact" else built


def _gradients(renderer: Renderer, number: int, dtype: torch.dtype, rounded: bool) -> dict[str, Tensor]:
    """Flat gradients of the log-odds by each group. `rounded` takes the network's at the 8-bit image, as the attack's
    loop does, and passes it straight through the rounding."""
    target = load(NETWORK, dtype)
    start = renderer.initial()
    leaves = {group: start[group].clone().requires_grad_() for group in renderer.plan.groups}
    image = renderer.render({group: leaf[None] for group, leaf in leaves.items()})
    seen = as_saved(image) if rounded else image.detach()
    seen = seen.to(dtype).requires_grad_()
    (by_image,) = torch.autograd.grad(log_odds(target.logits(seen), number).sum(), seen)
    found = torch.autograd.grad(image, list(leaves.values()), by_image.to(image.dtype))
    return {group: value.flatten().double() for group, value in zip(leaves, found, strict=True)}


@dataclass(frozen=True)
class WrongSigns:
    """share: part of the coordinates whose sign is wrong. weight: part of the gradient's absolute sum that they hold; a
    step by the signs then gains 1 − 2 · weight of what it gains with the right ones."""

    share: float
    weight: float


def wrong_signs(found: Tensor, wanted: Tensor) -> WrongSigns:
    """Of estimates [..., n] of a gradient [n], over all coordinates that are not 0 in both.

    The sign of 0 is 0: a coordinate that is estimated as 0 and is not is wrong, and so is the converse, which weighs
    nothing.
    """
    wanted = wanted.expand_as(found)
    counted = (found != 0) | (wanted != 0)
    wrong = (found.sign() != wanted.sign()) & counted
    size, total = wanted.abs().double(), float(wanted.abs().double().sum())
    return WrongSigns(
        share=float(wrong.sum()) / max(1, int(counted.sum())),
        weight=float(size[wrong].sum()) / total if total else 0.0,
    )
