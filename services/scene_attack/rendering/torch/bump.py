"""Dents: a height over the surface of each object, which turns its normals. It is of the object, not of the image, so
that one dented object is the same from every view.

The height is a solid function of the place in the object's own frame (scene_attack.rendering.torch.lattice). To first
order a surface with the normal n that is raised by h has the normal n − ∇h + (n·∇h) n: the normals are those of a
surface that exists, unlike two free angles per pixel. Neither points nor outlines nor shadows move.

The size of an object is the diameter of its bounding sphere, and coefficients are thousandths of it: millimetres for a
thing of one metre. Where they would be steeper than `STEEPEST`, dents are drawn less high.
"""

from dataclasses import dataclass
from math import radians, tan

import torch
from torch import Tensor

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch.lattice import NODES, SPACING, Places, splines
from scene_attack.rendering.torch.table import to_angles, to_vectors
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene

LARGEST = 20.0
"""Largest magnitude of a coefficient, and so of a height, in thousandths of the size."""
STEEPEST = 29.0
"""Steepest slope, degrees, at the places of `PER_CELL`; between them slopes are at most 3 % larger, so nowhere above
30°."""
PER_CELL = 2
"""Places along each edge of a cell at which slopes are limited: its node and its middle, where steep waves are
steepest."""
UNIT = 2 * FIT_RADIUS / 1000
"""Scene units, at scale 1, of a coefficient of 1."""
NEXT_TO_POLE = 1e-12
"""Angle, radians, by which a normal at the pole is moved off it, where its azimuth has no derivative."""


@dataclass(frozen=True)
class Bump:
    """The surfaces that are `shown`, and their `places` in the lattice.

    `normals` float64 [P, 3], the unit normals without dents, camera's frame; `to_camera` float64 [P, 3, 3], which turns
    gradients in the object's frame, as columns, into the camera's.
    """

    shown: Fragments
    normals: Tensor
    places: Places
    to_camera: Tensor

    @classmethod
    def of(cls, scene: ResolvedScene, shown: Fragments, to_camera: Tensor) -> "Bump":
        """The places of the surfaces `shown`. `to_camera` [3, 3] turns world vectors, as rows, into the camera's
        frame.
        """
        turns = to_camera.new_zeros(len(shown.pixels), 3, 3)
        for k in range(len(scene.description.objects)):
            linear = torch.as_tensor(scene.placed[k].model, dtype=torch.float64, device=to_camera.device)[:3, :3]
            turns[shown.object_index == k] = to_camera.T @ linear / torch.linalg.vector_norm(linear[:, 0])
        return cls(shown, shown.normals.double() @ to_camera, Places.of(scene, shown, to_camera.device), turns)

    def turned(self, angles: Tensor, coefficients: Tensor) -> Tensor:
        """Returns angles [P, 2], turned by the dents `coefficients` [objects, NODES, NODES, NODES], in the dtype of the
        angles. It is differentiable (once)."""
        own = to_vectors(angles)
        normals = _off_pole(own)
        after = raised(normals, self.slopes(limited(coefficients)))
        before, after = to_angles(normals), to_angles(_off_pole(after))
        # What rounding did to the angles is taken back, so that a surface without dents has the same bits; polar angles
        # beyond 0 and π are those of other azimuths.
        same = (normals == own).all(-1, keepdim=True) & ((before - angles)[:, 1:].abs() < 1e-5)
        return after + torch.where(same, (angles - before).detach(), 0.0)

    def tilts(self, coefficients: Tensor) -> Tensor:
        """Angles [P], radians, by which the dents `coefficients` turn the normals: their slopes along the surface."""
        across = raised(self.normals, self.slopes(limited(coefficients.double()))) - self.normals
        angles: Tensor = torch.linalg.vector_norm(across, dim=-1).atan()
        return angles

    def slopes(self, coefficients: Tensor) -> Tensor:
        """Gradients [P, 3] of the height that the coefficients have unlimited, in the camera's frame, lengths per
        length: 1 is 45°."""
        gradients = self.places.gradients(coefficients) * (UNIT / SPACING)
        return (self.to_camera.to(gradients) @ gradients[..., None])[..., 0]

    def heights(self, coefficients: Tensor) -> Tensor:
        """Heights [P] of the surfaces in the dents `coefficients`, in their unit; 0 for those that are no object's."""
        return self.places.values(limited(coefficients)[..., None])[:, 0]


def limited(coefficients: Tensor) -> Tensor:
    """Coefficients of the dents that are drawn. Where dents would be steeper than `STEEPEST`, the nodes around are
    divided by the excess, and then all of the object's by what is left of it. It is differentiable where no two places
    are equally steep."""
    from_each = torch.nn.functional.pad(steepness(coefficients)[:, None], (2 * PER_CELL,) * 6)  # as far as nodes go
    around = torch.nn.functional.max_pool3d(from_each, 2 * PER_CELL + 1, stride=PER_CELL)[:, 0]
    lower = coefficients / around.clamp_min(1.0)
    return lower / steepness(lower).amax((1, 2, 3)).clamp_min(1.0)[:, None, None, None]


def steepness(coefficients: Tensor) -> Tensor:
    """Slopes that the coefficients have unlimited, in parts of the largest allowed, at `PER_CELL` places along each
    edge of the cells: [objects, places, places, places]."""
    values, slopes = _along_an_axis(coefficients)
    along = (slopes, values, values), (values, slopes, values), (values, values, slopes)
    gradient = torch.stack([torch.einsum("oijk,ai,bj,ck->oabc", coefficients, *of) for of in along])
    parts: Tensor = torch.linalg.vector_norm(gradient, dim=0) * (UNIT / SPACING / tan(radians(STEEPEST)))
    return parts


def _along_an_axis(like: Tensor) -> tuple[Tensor, Tensor]:
    """Weights [places, NODES] of the nodes along an axis, of the value and the slope, at `PER_CELL` places a cell."""
    steps = torch.arange((NODES - 3) * PER_CELL + 1, dtype=torch.float64) / PER_CELL
    first = steps.floor().clamp_max(NODES - 4.0)
    nodes = first.long()[:, None] + torch.arange(4)
    empty = torch.zeros(len(steps), NODES, dtype=torch.float64)
    values, slopes = (empty.scatter(1, nodes, of[:, 0]).to(like) for of in splines((steps - first)[:, None]))
    return values, slopes


def raised(normals: Tensor, slopes: Tensor) -> Tensor:
    """Vectors [P, 3] along the normals of surfaces that are raised by a height of gradient `slopes`, to first order.

    `normals` are unit vectors; the result is 1 / cos(slope) long.
    """
    return normals - slopes + (normals * slopes).sum(-1, keepdim=True) * normals


def _off_pole(normals: Tensor) -> Tensor:
    """Moves vectors [P, 3] that are straight up or down a little towards the viewer."""
    x, y, z = normals.detach().unbind(-1)
    at_pole = torch.hypot(x, z) < 0.5 * NEXT_TO_POLE * y.abs()
    return normals + torch.stack((0 * x, 0 * y, NEXT_TO_POLE * at_pole), dim=-1)
