"""Shape: every point of an object's surface is moved, so that outlines and shadows follow. It is of the object, not of
the image, so that one bent object is the same from every view.

A point x of the object's own frame moves to x + d(x), where the components of d are solid functions of the place
(scene_attack.rendering.torch.lattice), in thousandths of the size: the diameter of the bounding sphere. With J = 1 + ∇d
the normal n becomes J⁻ᵀ n. Where the Frobenius norm of ∇d would be above `STEEPEST`, the object is bent less: then no
two points meet, no normal turns by more than 36°, and no line on the surface becomes longer or shorter by more than
60 %. The triangles are divided first (`divided`), so that flat ones bend too.

Gradients are those inside the outlines: a further displacement δd turns the normal of each point as a height n·δd over
the surface does (`bump.raised`), to first order. That another point is then seen through a pixel, that outlines move
and that shadows do is in the image, and left out of its gradient.
"""

from dataclasses import dataclass, replace
from math import radians, sin

import torch
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch import bump, lattice
from scene_attack.rendering.torch.bump import UNIT, Bump
from scene_attack.rendering.torch.lattice import Lattice, Places
from scene_attack.scenes.division import MOST, divided, pieces
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh, Part
from scene_attack.scenes.resolve import ResolvedScene

LARGEST = 20.0
"""Largest magnitude of a coefficient, and so of a component of a displacement, in thousandths of the size."""
STEEPEST = sin(radians(27.0))
"""Largest Frobenius norm of ∇d at the places where it is limited (`lattice.limited`). Between them the norms of three
gradients are 9 % larger for random signs, but up to 37 % where an ascent over the coefficients looks for it: then the
spectral norm is 0.587. With ∇d = G the old normal is along n' + Gᵀn', which is at most asin |G| from the new one, n',
and lengths change by at most |G|, in the spectral norm."""
EDGE = 1 / 3
"""Longest edge of the triangles, in cells: a sixth of the shortest wave, between whose ends a straight line is at most
14 % of the wave's height off."""
NEARLY = 1e-8 * FIT_RADIUS
"""Distance, scene units, to which `Shape.rest` finds points: less than the depths of an image resolve."""
MOST_STEPS = 40
"""Of the search for them, in each of which they are off by at most 0.6 times as much as before."""


def limited(coefficients: Tensor) -> Tensor:
    """Coefficients [objects, nodes, nodes, nodes, 3] of the displacement that is drawn: nowhere steeper than
    `STEEPEST`."""
    return lattice.limited(coefficients, STEEPEST / UNIT)


def steepness(coefficients: Tensor) -> Tensor:
    """Largest norm [objects] of the gradient that the coefficients have unlimited, in parts of the largest allowed."""
    return lattice.steepness(coefficients).amax((1, 2, 3)) * (UNIT / STEEPEST)


@dataclass(frozen=True)
class Shape:
    """The displacement of each object that has the coefficients `drawn` [objects, nodes, nodes, nodes, 3], as `limited`
    returns them."""

    drawn: Tensor

    @classmethod
    def of(cls, coefficients: Tensor) -> "Shape":
        """That which is drawn for the coefficients."""
        return cls(limited(coefficients.detach().cpu().double()))

    def meshes(self, meshes: tuple[Mesh, ...]) -> tuple[Mesh, ...]:
        """The objects' meshes in this shape."""
        longest = longest_edge(Lattice.under(self.drawn))
        return tuple(
            replace(mesh, parts=tuple(self._bent(part, k) for part in divided(mesh, longest).parts))
            if self.drawn[k].any()
            else mesh
            for k, mesh in enumerate(meshes)
        )

    def _bent(self, part: Part, k: int) -> Part:
        points, normals = torch.from_numpy(part.vertices).double(), torch.from_numpy(part.normals)
        places = Places.on(Lattice.under(self.drawn), points, k)
        vertices = Shape(self.drawn.float())  # as vertices are
        stretch = vertices.stretch(places)
        x, y, z = stretch.unbind(-1)
        cofactors = torch.stack([torch.linalg.cross(*of) for of in ((y, z), (z, x), (x, y))], dim=-1)  # along J⁻ᵀ
        material = part.metallic_roughness
        if material is not None:
            along, side = torch.from_numpy(material.tangents).tensor_split([3], dim=1)
            tangents = torch.cat([_turned(stretch, along), side], dim=1)
            material = replace(material, tangents=tangents.numpy())
        return replace(
            part,
            vertices=(points + vertices.displaced(places)).float().numpy(),
            normals=_turned(cofactors, normals).numpy(),
            metallic_roughness=material,
        )

    def displaced(self, places: Places) -> Tensor:
        """Displacements [P, 3] of points, in scene units of the objects' frames at scale 1."""
        return places.values(self.drawn) * UNIT

    def stretch(self, places: Places) -> Tensor:
        """Jacobians J [P, 3, 3] of where points go, in the objects' frames."""
        gradients = places.gradients(self.drawn) * UNIT
        return torch.eye(3).to(gradients) + gradients.mT

    def rest(self, points: Tensor, index: Tensor) -> Tensor:
        """The points float64 [P, 3] of the objects `index` int64 [P] before they were displaced to `points`.

        Each is the fixed point of x ← x' − d(x).
        """
        before = points
        for _ in range(MOST_STEPS):
            places = Places.at(Lattice.under(self.drawn), before, index, torch.ones_like(index, dtype=torch.bool))
            before, last = points - self.displaced(places), before
            if not len(points) or float((before - last).abs().amax()) <= NEARLY:
                break
        return before


def longest_edge(lattice: Lattice) -> float:
    """Longest edge of the triangles of a mesh that is bent, in scene units at scale 1."""
    return EDGE * lattice.spacing


def check_meshes(scene: ResolvedScene, lattice: Lattice) -> None:
    """Raises InvalidRequest if an object's triangles are so long that bending it would take more memory than there
    may be."""
    for k, mesh in enumerate(scene.meshes):
        if (count := pieces(mesh, longest_edge(lattice))) > MOST:
            raise InvalidRequest(
                f"scene.objects.{k}.mesh",
                f"to be bent, its {mesh.triangles:,} triangles would be divided into some {count:,}, and at most "
                f"{MOST:,} are made; give it shorter triangles, or `attack` a longer `wavelength`",
            )


def bent(scene: ResolvedScene, perturbation: Parameters) -> ResolvedScene:
    """The scene with the dents and the shape of a perturbation in its objects' meshes: dents as normals at vertices,
    of the mesh as it is where too many triangles would be needed."""
    meshes = scene.meshes
    if "bump" in perturbation:
        drawn = bump.limited(perturbation["bump"].double())
        longest = longest_edge(Lattice.under(drawn))
        finer = [divided(mesh, longest) if pieces(mesh, longest) <= MOST else mesh for mesh in meshes]
        meshes = tuple(
            replace(mesh, parts=tuple(bump.dented(part, k, drawn) for part in mesh.parts))
            for k, mesh in enumerate(finer)
        )
    if "shape" in perturbation:
        meshes = Shape.of(perturbation["shape"]).meshes(meshes)
    return replace(scene, meshes=meshes)


def slopes(surfaces: Bump, change: Tensor) -> Tensor:
    """Slopes [P, 3], camera's frame, of the heights by which a change of the drawn coefficients displaces the surfaces
    along their normals: to first order it turns them as these dents would."""
    own = surfaces.turns.mT @ surfaces.normals[..., None]
    return (surfaces.to_camera @ (surfaces.places.gradients(change.double()) * UNIT @ own))[..., 0]


def _turned(by: Tensor, vectors: Tensor) -> Tensor:
    """Unit vectors [V, 3] along vectors [V, 3], turned by matrices [V, 3, 3]; zeros stay."""
    return torch.nn.functional.normalize((by @ vectors[..., None])[..., 0], dim=-1, eps=1e-30)
