"""The renderer `blender`: what it sends to Blender's process, and the images that come back."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from scene_attack.rendering.plan import Item
from scene_attack.rendering.pyrender.path_tracer import Frame, PathTracer
from scene_attack.scenes.mesh import Bytes, Part
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.solids import has_holes
from scene_attack.scenes.view import NEAR
from scene_attack_blender.plugin import BLENDER
from scene_attack_blender.process import StagedScene, blender

SKY_GRADIENT = 0.5
"""The sky has the radiance mean · (1 + gradient · y) in direction y (`Frame.ambient`)."""


class BlenderRenderer(PathTracer):
    """Images by Blender's Cycles on the CPU, without its denoiser, display transform and add-ons.

    Surfaces reflect the light of lamps as pyrender has it (see `cycles.py`).
    """

    declaration = BLENDER

    @property
    def tracer(self) -> str:
        """Cycles, with Blender's version."""
        return f"Cycles of Blender {version('bpy')}"

    def trace(self, frame: Frame) -> NDArray[np.float32]:
        """Has Blender draw the frame. Raises JobFailure as `BlenderProcess.image` does."""
        values = {name: np.asarray(value).tolist() for name, value in vars(frame).items()}
        image = blender().image(self._staged, values | {"samples": self.samples, "seed": self.seed})
        return np.ascontiguousarray(image.reshape(*self.size, 4)[::-1])  # Blender's first row is the bottom one

    def unmapped(self) -> Sequence[Item]:
        """Occlusion maps, and textures that repeat along one side only."""
        items = list(super().unmapped())
        for placed in self.scene.placed:
            surfaces = [part.metallic_roughness for part in placed.mesh.parts if part.metallic_roughness is not None]
            uneven = sum(len({*m.wrap}) > 1 for surface in surfaces for m in surface.maps.values())
            if uneven:
                why = "repeated along both sides: Blender has one way for both"
                items.append(Item(part=placed.name, what="textures wrapped in two ways", kept=0, of=uneven, why=why))
        return items

    @cached_property
    def _staged(self) -> StagedScene:
        what = "staged for Blender", self.bounces, torch.get_num_threads()
        return self.scene.once(what, lambda: staged(self.scene, self.bounces))


def staged(scene: ResolvedScene, bounces: int) -> StagedScene:
    """The scene as `cycles.Stage` takes it."""
    camera, lights, shadows = scene.description.camera, scene.description.lights, scene.description.shadows
    parts: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for thing, placed in enumerate(scene.placed):
        for part in placed.mesh.parts:
            described, own = _part(part)
            arrays |= {f"{len(parts)}.{name}": array for name, array in own.items()}
            parts.append({"thing": thing, **described})
    far = scene.projection[2, 3] / (scene.projection[2, 2] + 1)
    described_scene = {
        "size": camera.size,
        "field_of_view": camera.field_of_view,
        "near": NEAR,
        "far": float(far),
        "bounces": bounces,
        "threads": torch.get_num_threads(),
        "sky_gradient": SKY_GRADIENT,
        "shadows": None if shadows is None else (shadows.softness, shadows.angle),
        "points": len(lights.points),
        "directionals": len(lights.directional),
        "spots": len(lights.spots),
        "parts": parts,
    }
    return StagedScene(described_scene, arrays)


def _part(part: Part) -> tuple[dict[str, Any], Mapping[str, NDArray[Any]]]:
    """A part's surface as `cycles.Stage` takes it, and its arrays."""
    surface, texture = part.metallic_roughness, part.texture if part.uv is not None else None
    arrays: dict[str, NDArray[Any]] = {"vertices": part.vertices, "normals": part.normals, "faces": part.faces}
    if part.uv is not None:
        arrays["uv"] = part.uv
    described: dict[str, Any] = {
        "color": part.color.tolist(),
        "texture": None if texture is None else texture.shape[:2],
        "holes": has_holes(part),
        "coated": True,
        "surface": None,
    }
    if texture is not None:
        arrays["texture"] = _texels(texture)
    if surface is not None:
        arrays |= {"second_uv": surface.second_uv, "vertex_colors": surface.vertex_colors}
        maps = {name: image for name, image in surface.maps.items() if name != "occlusion"}
        arrays |= {f"map.{name}": _texels(image.texels) for name, image in maps.items()}
        plain = ("metallic", "roughness", "emissive", "alpha_mode", "alpha_cutoff", "double_sided", "normal_scale")
        described["surface"] = {name: getattr(surface, name) for name in plain} | {
            "maps": {name: (image.texels.shape[:2], image.uv_set, image.wrap) for name, image in maps.items()}
        }
    return described, arrays


def _texels(texels: Bytes) -> NDArray[np.float32]:
    """Texels in [0,1], the bottom row first."""
    return texels[::-1].astype(np.float32) / np.float32(255)
