"""Ways to break views, meshes, point lights and whole images."""

from dataclasses import replace

import numpy as np
import torch

from scene_attack.attacks import problem
from scene_attack.rendering.pyrender import renderer as pyrender_renderer
from scene_attack.scenes import resolve
from scene_attack.scenes.reading import normals, surfaces
from scene_attack_accuracy.stability import attacks, geometry, meshes, pyrender_light, torch_shading
from tests.unit.accuracy.damage import breaks


@breaks("rasterise", geometry, torch_shading)
def shifted_frames(true, scene):
    """Rasterised images that are one pixel too low, their coverage nine tenths of what it is."""
    seen = true(scene)
    moved = {name: getattr(seen, name).roll(2, 0) for name in ("normals", "coverage", "base_color", "depth")}
    return replace(seen, **moved | {"coverage": 0.9 * moved["coverage"]})


@breaks("rasterise", torch_shading)
def long_normals(true, scene):
    """Normals that are not of length 1."""
    seen = true(scene)
    return replace(seen, normals=1.1 * seen.normals)


def anything_in_view(patch) -> None:
    """Every object is in view."""
    patch.setattr(resolve, "visible_area", lambda *_: np.inf)


def kept_faces(patch) -> None:
    """Triangles without area, and repeated ones, are kept."""
    patch.setattr(normals, "usable_faces", lambda _, faces, __: np.arange(len(faces)))


@breaks("fitted", surfaces)
def fitted_by_mean(true, parts):
    """Meshes are moved so that the mean of their vertices is in the middle."""
    found = true(parts)
    middle = np.concatenate([part.vertices for part in found]).mean(axis=0)
    return tuple(replace(part, vertices=part.vertices - middle) for part in found)


def no_orientation(patch) -> None:
    """Faces keep their winding, also where their neighbours are wound the other way."""
    patch.setattr(normals, "orientation", lambda n, *_: np.ones(n))


def no_weld(patch) -> None:
    """Vertices at the same place are not one point."""
    patch.setattr(normals, "weld", lambda vertices: np.arange(len(vertices)))


@breaks("usable_faces", normals)
def lost_duplicates(true, vertices, faces, points):
    """None of several equal triangles is kept."""
    kept = true(vertices, faces, points)
    _, where, count = np.unique(np.sort(points[faces], axis=1), axis=0, return_inverse=True, return_counts=True)
    return kept[count[where.ravel()][kept] == 1]


def narrow_range(patch) -> None:
    """Coordinates beyond 1e5 and sizes below 1e-5 are refused."""
    patch.setattr(surfaces, "MAX_COORDINATE", 1e5)


def float32_files(patch) -> None:
    """Coordinates are read in float32."""
    true = meshes.as_obj
    patch.setattr(meshes, "as_obj", lambda v, f: true(v.astype(np.float32).astype(np.float64), f))


@breaks("read_mesh", meshes)
def lost_faces(true, *given):
    """The last tenth of a file's triangles is not read, nor those wound inwards."""
    parts = true(*given)
    kept = []
    for part in parts:
        corners = part.vertices[part.faces]
        outwards = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(1) > 0
        kept.append(replace(part, faces=part.faces[outwards & (np.arange(len(part.faces)) < 0.9 * len(part.faces))]))
    return tuple(kept)


def any_file(patch) -> None:
    """Every file is read as a mesh without parts."""
    patch.setattr(meshes, "read_mesh", lambda *_: ())


def no_checks(patch) -> None:
    """Nothing is ever found to be not finite."""
    patch.setattr(torch, "isfinite", lambda values: torch.ones_like(values, dtype=torch.bool))
    for module in (problem, pyrender_renderer):
        patch.setattr(module, "finite", lambda _: True, raising=False)


def stray_light(patch) -> None:
    """Images and radiances that have a little of every light, wherever it is, and are not bounded."""

    class Stray(pyrender_light.PyrenderRenderer):
        def _light(self, parameters):
            return parameters.get("illumination", self.initial()["illumination"][None])

        def radiance(self, parameters):
            found, light = super().radiance(parameters), self._light(parameters)
            return found + 1e-3 * torch.tanh(light[:, 1:].abs().sum(1).clamp(1e-3, 1e3)).float()[:, None, None, None]

        def render(self, parameters):
            light = self._light(parameters)
            stray = torch.tanh(1e-2 * light[:, 1].abs()) + 0.2 * torch.log10(1 + light[:, 4].abs())
            return 0.5 * super().render(parameters) + 1e-2 * stray.float()[:, None, None, None]

    patch.setattr(pyrender_light, "PyrenderRenderer", Stray)


BUILDERS = (torch_shading, geometry, attacks, meshes)
"""Modules that make renderers."""


class Damaged:
    """A renderer whose images go through `change`(image, parameters)."""

    def __init__(self, renderer, change) -> None:
        self._renderer, self._change = renderer, change

    def __getattr__(self, name):
        return getattr(self._renderer, name)

    def render(self, parameters):
        return self._change(self._renderer.render(parameters), parameters)

    def exact(self):
        return Damaged(self._renderer.exact(), self._change)


def images(change):
    """Breaks every renderer that a case makes."""
    return breaks("build", *BUILDERS)(lambda true, *given, **named: Damaged(true(*given, **named), change))


lighter_images = images(lambda image, _: (image + 0.01).clamp_max(1))
moved_by_parameters = images(lambda image, given: image + 1e-3 * sum(bool(v.abs().max() > 50) for v in given.values()))
eight_bit_images = images(
    lambda image, given: image.bfloat16().float() if any(v.dtype == torch.bfloat16 for v in given.values()) else image
)


grainy_images = images(lambda image, _: image if image.shape[1] == 64 else image + 0.01)
