"""What the torch renderer shades: the surfaces of the covered pixels, with the angles of their normals.

A pixel has one pair of angles among the parameters. Where it shows several surfaces they are those of the surface with
the largest share, and a change of them turns the others by the same angles.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from services.rendering.opengl.fragments import Fragments
from services.rendering.opengl.gbuffer import GBuffer
from services.rendering.torch_renderer import lookup_table
from services.rendering.torch_renderer.normals import to_angles


@dataclass(frozen=True)
class VisibleSurfaces:
    """The surfaces, sorted by object and then by normal, so that neighbours see the same light.

    image: the angles of each pixel [H, W, 2], 0 where nothing is. shown: the surfaces. angles: theirs [P, 2]. turns:
    what their angles are more than their pixel's [P, 2], or None where each pixel shows one surface. Angles are in
    radians, in the camera's frame, float64 rounded to float32, so that the exact renderer renders the same scene.
    """

    image: Tensor
    shown: Fragments
    angles: Tensor
    turns: Tensor | None

    @property
    def ranks(self) -> tuple[Tensor, ...]:
        """The surfaces that are the first of their pixels, the second, and so on; empty where each shows one."""
        if self.turns is None:
            return ()
        return tuple((self.shown.rank == k).nonzero()[:, 0] for k in range(int(self.shown.rank.amax()) + 1))

    def ordered(self, order: Tensor) -> "VisibleSurfaces":
        """Returns the surfaces in another order."""
        turns = None if self.turns is None else self.turns[order]
        return VisibleSurfaces(self.image, self.shown.some(order), self.angles[order], turns)


def visible_surfaces(gbuffer: GBuffer, to_camera: Tensor) -> VisibleSurfaces:
    """Returns what a G-buffer shows. `to_camera` [3, 3] turns world vectors, as rows, into the camera's frame."""
    shown, normals = gbuffer.surfaces(), gbuffer.normals
    if gbuffer.fragments is not None:
        first = shown.rank == 0
        normals = torch.zeros_like(normals)
        normals.view(-1, 3)[shown.pixels[first]] = shown.normals[first]
    image = _rounded(to_angles(normals.to(torch.float64) @ to_camera) * (gbuffer.coverage > 0)[..., None])
    angles = image.reshape(-1, 2)[shown.pixels]
    turns = None
    if gbuffer.fragments is not None:
        own = torch.where(first[:, None], angles, _rounded(to_angles(shown.normals.to(torch.float64) @ to_camera)))
        angles, turns = own, own - angles
    keys = shown.object_index * lookup_table.N_SORT_KEYS + lookup_table.normal_sort_keys(angles)
    return VisibleSurfaces(image, shown, angles, turns).ordered(torch.argsort(keys, stable=True))


def _rounded(angles: Tensor) -> Tensor:
    return angles.to(torch.float32).to(torch.float64)
