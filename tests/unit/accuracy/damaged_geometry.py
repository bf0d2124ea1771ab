"""Ways to break views, meshes and point lights, each as a function of pytest's monkeypatch."""

from dataclasses import replace

import numpy as np
import torch

from services.accuracy.stability import geometry, meshes, pyrender_light, torch_shading
from services.attacks import problem
from services.rendering.pyrender_renderer import renderer as pyrender_renderer
from services.scenes import resolve
from services.scenes.reading import normals, surfaces


def shifted_frames(patch) -> None:
    """Rasterised images that are one pixel too low, their coverage nine tenths of what it is."""
    for module in (geometry, torch_shading):
        true = module.rasterise

        def rasterise(scene, true=true):
            seen = true(scene)
            moved = {name: getattr(seen, name).roll(2, 0) for name in ("normals", "coverage", "base_color", "depth")}
            return replace(seen, **moved | {"coverage": 0.9 * moved["coverage"]})

        patch.setattr(module, "rasterise", rasterise)


def long_normals(patch) -> None:
    """Normals that are not of length 1."""
    true = torch_shading.rasterise

    def rasterise(scene):
        seen = true(scene)
        return replace(seen, normals=1.1 * seen.normals)

    patch.setattr(torch_shading, "rasterise", rasterise)


def anything_in_view(patch) -> None:
    """Every object is in view."""
    patch.setattr(resolve, "visible_area", lambda *_: np.inf)


def kept_faces(patch) -> None:
    """Triangles without area, and repeated ones, are kept."""
    patch.setattr(normals, "usable_faces", lambda _, faces, __: np.arange(len(faces)))


def fitted_by_mean(patch) -> None:
    """Meshes are moved so that the mean of their vertices is in the middle."""
    true = surfaces.fitted

    def fitted(parts):
        found = true(parts)
        middle = np.concatenate([part.vertices for part in found]).mean(axis=0)
        return tuple(replace(part, vertices=part.vertices - middle) for part in found)

    patch.setattr(surfaces, "fitted", fitted)


def no_orientation(patch) -> None:
    """Faces keep their winding, also where their neighbours are wound the other way."""
    patch.setattr(normals, "orientation", lambda n, *_: np.ones(n))


def no_weld(patch) -> None:
    """Vertices at the same place are not one point."""
    patch.setattr(normals, "weld", lambda vertices: np.arange(len(vertices)))


def lost_duplicates(patch) -> None:
    """None of several equal triangles is kept."""
    true = normals.usable_faces

    def without_repeated(vertices, faces, points):
        kept = true(vertices, faces, points)
        _, where, count = np.unique(np.sort(points[faces], axis=1), axis=0, return_inverse=True, return_counts=True)
        return kept[count[where.ravel()][kept] == 1]

    patch.setattr(normals, "usable_faces", without_repeated)


def narrow_range(patch) -> None:
    """Coordinates beyond 1e5 and sizes below 1e-5 are refused."""
    patch.setattr(surfaces, "MAX_COORDINATE", 1e5)


def float32_files(patch) -> None:
    """Coordinates are read in float32."""
    true = meshes.as_obj
    patch.setattr(meshes, "as_obj", lambda v, f: true(v.astype(np.float32).astype(np.float64), f))


def lost_faces(patch) -> None:
    """The last tenth of a file's triangles is not read, nor those wound inwards."""
    true = meshes.read_mesh

    def read_mesh(*given):
        parts = true(*given)
        kept = []
        for part in parts:
            corners = part.vertices[part.faces]
            outwards = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(
                1
            ) > 0
            kept.append(
                replace(part, faces=part.faces[outwards & (np.arange(len(part.faces)) < 0.9 * len(part.faces))])
            )
        return tuple(kept)

    patch.setattr(meshes, "read_mesh", read_mesh)


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
        def radiance(self, parameters):
            found = super().radiance(parameters)
            light = parameters.get("illumination", self.initial()["illumination"][None])
            return found + 1e-3 * torch.tanh(light[:, 1:].abs().sum(1).clamp(1e-3, 1e3)).float()[:, None, None, None]

        def render(self, parameters):
            light = parameters["illumination"]
            stray = torch.tanh(1e-2 * light[:, 1].abs()) + 0.2 * torch.log10(1 + light[:, 4].abs())
            return 0.5 * super().render(parameters) + 1e-2 * stray.float()[:, None, None, None]

    patch.setattr(pyrender_light, "PyrenderRenderer", Stray)
