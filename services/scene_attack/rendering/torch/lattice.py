"""A lattice in each object's own frame, whose nodes cubic B-splines join to a solid function of the place.

The function is a sum of tensor products of cubic B-splines (Unser 1999, eq. 4). It needs no map of the surface and no
mesh without holes, it is twice continuously differentiable, never beyond its largest coefficient, and it has nearly
nothing of wavelengths shorter than `WAVELENGTH`, as nodes are half of that apart. The size of an object is the diameter
of its bounding sphere.
"""

import torch
from torch import Tensor

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch.surfaces import camera_rays
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene

WAVELENGTH = 0.1
"""Shortest wavelength of the function, in sizes of the object."""
NODES = round(2 / WAVELENGTH) + 3
"""Nodes of the lattice along each axis: those of a cube around the bounding sphere, and one more on each side but the
last, where there are two, so that each point of it has four."""
SPACING = FIT_RADIUS * WAVELENGTH
"""Distance of nodes, in scene units at scale 1."""
CHUNK = 16_384
"""Surfaces whose 64 nodes each are held at a time: 25 MB in float64."""


def places(scene: ResolvedScene, shown: Fragments, device: torch.device) -> tuple[Tensor, Tensor]:
    """Returns the places of the surfaces `shown` in the lattices of their objects.

    The first result, int64 [P], is the flat index of the first of the 64 nodes of each, among those of all objects; the
    second, float64 [P, 3], in [0,1], is the place in the cell. Surfaces that are no object's have those of any node.
    """
    index = shown.object_index
    world = torch.from_numpy(scene.eye + camera_rays(scene, shown) * shown.depth.cpu().numpy()[:, None]).to(device)
    points = torch.zeros_like(world)
    for k in range(len(scene.description.objects)):
        model = torch.as_tensor(scene.placed[k].model, dtype=torch.float64, device=device)
        own = index == k
        points[own] = torch.linalg.solve(model[:3, :3], (world[own] - model[:3, 3]).T).T
    steps = ((points + FIT_RADIUS) / SPACING).clamp(0.0, NODES - 3.0)
    cell = steps.floor().clamp_max(NODES - 4.0)
    across = cell.long()
    first = (((index.clamp_min(0) * NODES + across[:, 0]) * NODES) + across[:, 1]) * NODES + across[:, 2]
    return torch.where(index < len(scene.description.objects), first, 0), steps - cell


def nodes(first: Tensor, device: torch.device) -> Tensor:
    """The flat indices [P, 64] of the nodes of surfaces, of which the first are [P]."""
    steps = torch.arange(4, device=device)
    return first[:, None] + ((steps[:, None, None] * NODES + steps[:, None]) * NODES + steps).flatten()


def splines(within: Tensor) -> tuple[Tensor, Tensor]:
    """The four cubic B-splines that are not 0 at places [P, 3] within a cell, and their derivatives: each [P, 3, 4]."""
    t, s = within, 1 - within
    values = (s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3)
    derivatives = (-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2)
    return torch.stack(values, dim=-1) / 6, torch.stack(derivatives, dim=-1) / 2


def product(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """The products [P, 64] of factors [P, 4] along each axis."""
    return (x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]).flatten(1)
