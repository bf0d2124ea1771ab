"""Dents: a height over the surface of each object, which turns its normals. It is of the object, not of the image, so
that one dented object is the same from every view.

The height is a solid function of the place in the object's own frame (scene_attack.rendering.torch.lattice). To first
order a surface with the normal n that is raised by h has the normal n − ∇h + (n·∇h) n: the normals are those of a
surface that exists, unlike two free angles per pixel. Neither points nor outlines nor shadows move.

The size of an object is the diameter of its bounding sphere, and coefficients are thousandths of it: millimetres for a
thing of one metre. Where they would be steeper than `STEEPEST`, dents are drawn less high.
"""

from dataclasses import dataclass, replace
from math import radians, tan

import torch
from torch import Tensor

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch import lattice
from scene_attack.rendering.torch.lattice import Lattice, Places
from scene_attack.rendering.torch.table import to_angles, to_vectors
from scene_attack.scenes.mesh import FIT_RADIUS, Part
from scene_attack.scenes.resolve import ResolvedScene

LARGEST = 20.0
"""Largest magnitude of a coefficient, and so of a height, in thousandths of the size."""
STEEPEST = 28.0
"""Steepest slope, degrees, at the places where slopes are limited (`lattice.limited`), so nowhere above 30°."""
UNIT = 2 * FIT_RADIUS / 1000
"""Scene units, at scale 1, of a coefficient of 1."""
NEXT_TO_POLE = 1e-12
"""Angle, radians, by which a normal at the pole is moved off it, where its azimuth has no derivative."""


@dataclass(frozen=True)
class Bump:
    """The surfaces that are `shown`, and their `places` in the lattice.

    `normals` float64 [P, 3], the unit normals without dents, camera's frame; `turns` float64 [P, 3, 3], from their
    objects' frames to the camera's; `to_camera` float64 [P, 3, 3], which turns gradients by the place in the lattice,
    as columns, into gradients by the place in the camera's frame.
    """

    shown: Fragments
    normals: Tensor
    places: Places
    turns: Tensor
    to_camera: Tensor

    @classmethod
    def of(
        cls, scene: ResolvedScene, shown: Fragments, places: Places, to_camera: Tensor, stretch: Tensor | None = None
    ) -> "Bump":
        """Those of the surfaces `shown`. `to_camera` [3, 3] turns world vectors, as rows, into the camera's frame;
        `stretch` [P, 3, 3] are the Jacobians of where the points of bent objects have gone, None where none is bent.
        """
        turns = to_camera.new_zeros(len(shown.pixels), 3, 3)
        for k in range(len(scene.description.objects)):
            linear = torch.as_tensor(scene.placed[k].model, dtype=torch.float64, device=to_camera.device)[:3, :3]
            turns[shown.object_index == k] = to_camera.T @ linear / torch.linalg.vector_norm(linear[:, 0])
        bent = turns if stretch is None else turns @ torch.linalg.inv(stretch).mT
        return cls(shown, shown.normals.double() @ to_camera, places, turns, bent)

    def turned(self, angles: Tensor, coefficients: Tensor) -> Tensor:
        """Returns angles [P, 2], turned by the dents `coefficients` [objects, nodes, nodes, nodes], in the dtype of the
        angles. It is differentiable (once)."""
        return tilted(angles, self.slopes(limited(coefficients)))

    def tilts(self, coefficients: Tensor) -> Tensor:
        """Angles [P], radians, by which the dents `coefficients` turn the normals: their slopes along the surface."""
        across = raised(self.normals, self.slopes(limited(coefficients.double()))) - self.normals
        angles: Tensor = torch.linalg.vector_norm(across, dim=-1).atan()
        return angles

    def slopes(self, coefficients: Tensor) -> Tensor:
        """Gradients [P, 3] of the height that the coefficients have unlimited, in the camera's frame, lengths per
        length: 1 is 45°."""
        gradients = self.places.gradients(coefficients[..., None]) * UNIT
        return (self.to_camera.to(gradients) @ gradients)[..., 0]

    def heights(self, coefficients: Tensor) -> Tensor:
        """Heights [P] of the surfaces in the dents `coefficients`, in their unit; 0 for those that are no object's."""
        return self.places.values(limited(coefficients)[..., None])[:, 0]


def dented(part: Part, k: int, drawn: Tensor) -> Part:
    """A part of the mesh of object `k` whose vertices have the normals of the dents `drawn`, float64 [objects, nodes,
    nodes, nodes], as `limited` returns them. It has them between its vertices too if its edges are short."""
    points, normals = (torch.from_numpy(of).double() for of in (part.vertices, part.normals))
    places = Places.on(Lattice.under(drawn), points, k)
    after = raised(normals, places.gradients(drawn[..., None])[..., 0] * UNIT)
    return replace(part, normals=torch.nn.functional.normalize(after, dim=-1).float().numpy())


def limited(coefficients: Tensor) -> Tensor:
    """Coefficients of the dents that are drawn: nowhere steeper than `STEEPEST`."""
    return lattice.limited(coefficients[..., None], tan(radians(STEEPEST)) / UNIT)[..., 0]


def steepness(coefficients: Tensor) -> Tensor:
    """Largest slope [objects] that the coefficients have unlimited, in parts of the largest allowed."""
    return lattice.steepness(coefficients[..., None]).amax((1, 2, 3)) * (UNIT / tan(radians(STEEPEST)))


def tilted(angles: Tensor, slopes: Tensor) -> Tensor:
    """Angles [P, 2] of the normals of surfaces that are raised by a height of gradient `slopes` [P, 3], to first order;
    the very same where they do not change."""
    own = to_vectors(angles)
    normals = _off_pole(own)
    after = raised(normals, slopes)
    before, after = to_angles(normals), to_angles(_off_pole(after))
    # What rounding did to the angles is taken back, so that a surface without dents has the same bits; polar angles
    # beyond 0 and π are those of other azimuths.
    same = (normals == own).all(-1, keepdim=True) & ((before - angles)[:, 1:].abs() < 1e-5)
    return after + torch.where(same, (angles - before).detach(), 0.0)


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
