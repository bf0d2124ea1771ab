"""Splits the covered pixels into regions of one object each: those that see all of the light, and those in shadow.

Where nothing hides any of the light, radiance is a function of the normal alone and every method of shading applies. A
pixel in shadow has a visibility of its own and is summed directly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from services.rendering.torch_renderer.visibility import WHOLE

IN_SHADOW = " in shadow"
"""End of the name of a region from which some of the light is hidden."""


@dataclass(frozen=True)
class Regions:
    """Regions of the covered pixels. `order` [P] sorts the pixels by region and keeps their order within one.

    For each region: `owners`, the object's index; `counts`, its pixels; `names`, what plans call it; `visibilities`,
    uint8 [D, its pixels] in units of 1 / WHOLE, None where nothing is hidden.
    """

    order: Tensor
    owners: list[int]
    counts: list[int]
    names: list[str]
    visibilities: list[Tensor | None]


def regions(owner: Tensor, visibility: Tensor | None, names: Sequence[str], by_shadow: bool = True) -> Regions:
    """Splits pixels that are sorted by their objects' indices, `owner` [P], by their `visibility` [D, P]; `names` are
    those of the objects.

    Every object has a region, be it empty; one with pixels of both kinds has two, the unshadowed pixels first. Without
    `by_shadow` it has one all the same: where the viewer is near, all pixels are summed directly.
    """
    if visibility is None or not by_shadow:
        counts = torch.bincount(owner, minlength=len(names)).tolist()
        order = torch.arange(len(owner), device=owner.device)
        parts: list[Tensor | None] = [None] * len(names)
        if visibility is not None:
            parts = [*torch.split(visibility, counts, dim=1)]
        return Regions(order, list(range(len(names))), counts, list(names), parts)
    shadowed = (visibility < WHOLE).any(0)
    found = Regions(torch.argsort(2 * owner + shadowed, stable=True), [], [], [], [])
    for k, name in enumerate(names):
        for kind, words in ((False, ""), (True, IN_SHADOW)):
            own = ((owner == k) & (shadowed == kind)).nonzero()[:, 0]
            if len(own) or (not kind and not bool((owner == k).any())):
                found.owners.append(k)
                found.counts.append(len(own))
                found.names.append(name + words)
                found.visibilities.append(visibility[:, own] if kind else None)
    return found
