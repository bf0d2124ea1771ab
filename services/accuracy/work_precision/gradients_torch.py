"""Gradients of the differentiable renderer from values alone; the reference is autograd in float64."""

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision.gradients import IMAGE, Objective
from services.accuracy.work_precision.shading_subject import GROUPS, smooth_weights
from services.attacks.seeds import generator
from services.rendering.color import as_saved
from services.rendering.factory import build
from services.rendering.protocol import Renderer
from services.scenes.resolve import ResolvedScene
from services.targets.protocol import Target
from services.targets.registry import load
from services.targets.scores import log_odds

NETWORK = "efficientnet-lite0"
ODDS = "log-odds"
COORDINATES = 8
"""Coordinates that are differenced one by one, drawn from those whose derivative is more than SEEN of the largest."""
SEEN = 0.05


def objectives(mesh: str, label: str, size: tuple[int, int], texels: tuple[int, int]) -> Iterator[Objective]:
    """⟨weights, image⟩ of each group through the exact image, the loop's and its 8 bits; and the log-odds of
    `label` of the material through the loop's image and its 8 bits."""
    scene = placed(
        mesh, size=size, thing={"material": "glossy-paint"}, lights={"environment": {"map": "studio", "size": texels}}
    )
    exact = build(scene, "torch", tolerance="exact")
    weights = smooth_weights(size)

    def weighted(images: Tensor) -> Tensor:
        return (images.double() * weights).sum(dim=(1, 2, 3))

    for group in GROUPS:
        yield _objective(scene, exact, group, IMAGE, weighted, weighted, ("float64", "float32", "8 bit"))
    number = load(NETWORK).labels.index(label)

    def odds(target: Target) -> Callable[[Tensor], Tensor]:
        return lambda images: log_odds(target.logits(images), number).double()

    narrow, wide = odds(load(NETWORK)), odds(load(NETWORK, torch.float64))
    yield _objective(scene, exact, "material", ODDS, narrow, wide, ("float32", "8 bit"))


def _objective(
    scene: ResolvedScene,
    exact: Renderer,
    group: str,
    of: str,
    function: Callable[[Tensor], Tensor],
    wide: Callable[[Tensor], Tensor],
    images: tuple[str, ...],
) -> Objective:
    """`function` of images [B, H, W, 3] to [B], and the same in float64 for the reference."""
    loop = build(scene, "torch", groups=(group,))
    start = exact.initial()[group]
    leaf = start.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(wide(exact.render({group: leaf[None]})).sum(), leaf)
    gradient = gradient.flatten()
    seen = (gradient.abs() > SEEN * gradient.abs().amax()).nonzero()[:, 0]
    some = seen[torch.randperm(len(seen), generator=generator(0, "coordinates", group))[:COORDINATES]].sort().values
    # an attack does not move normals that nothing shows
    free = (gradient != 0).nonzero()[:, 0] if group == "normals" else torch.arange(len(gradient))

    @torch.no_grad()
    def values(points: Tensor) -> Tensor:
        columns = []
        for point in points:
            whole = start.flatten().clone()
            whole[free] = point.double()
            parameters = {group: whole.reshape(1, *start.shape)}
            shown = loop.render({group: parameters[group].float()})
            seen = [exact.render(parameters)] if "float64" in images else []
            columns.append(torch.cat([function(image) for image in (*seen, shown, as_saved(shown))]))
        return torch.stack(columns)

    return Objective(
        renderer="torch",
        group=group,
        of=of,
        images=images,
        at=start.flatten()[free],
        coordinates=torch.searchsorted(free, some),
        values=values,
        gradient=gradient[free],
        how="autograd through the sum over all directions and lobes, and the network, in float64",
        resolution=torch.float32,
    )
