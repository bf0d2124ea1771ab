"""Small scenes for extreme cases: one object in front of the camera, under a given environment map."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from scene_attack.process import options
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import Floats, Mesh, Part
from scene_attack.scenes.resolve import ResolvedScene, resolve, with_surface

TABLES = (128, 128)
"""Height and width, in pixels, of an image large enough that a plan prefers tables to sums."""


@lru_cache(maxsize=1)
def library() -> Library:
    """The meshes and environment maps of this installation; no case asks for an upload."""
    return Library(options().cache_dir, options().cache_dir / "uploads")


def placed(
    mesh: str | tuple[Part, ...] = "primitive/sphere",
    *,
    size: tuple[int, int] = (24, 24),
    radiance: Floats | None = None,
    camera: dict[str, Any] | None = None,
    thing: dict[str, Any] | None = None,
    lights: dict[str, Any] | None = None,
    ground: tuple[float, float, float] | None = None,
    floor: dict[str, Any] | None = None,
) -> ResolvedScene:
    """Resolves a scene of one object, whose mesh is given by name or by its parts.

    `size` is the image's height and width in pixels. `camera`, `thing` (the object), `lights`, `ground` and `floor` are
    fields of the scene's description. `radiance` [rows, cols, 3] replaces the environment map. Raises as `resolve`
    does.
    """
    description = Scene.model_validate(
        {
            "camera": {"size": size} | (camera or {}),
            "objects": [{"mesh": mesh if isinstance(mesh, str) else "primitive/sphere"} | (thing or {})],
            "lights": {"environment": {"map": "uniform", "size": (8, 16)}} | (lights or {}),
        }
        | {name: value for name, value in (("ground", ground), ("floor", floor)) if value is not None}
    )
    scene = resolve(description, library())
    if not isinstance(mesh, str):
        own, described = Mesh(parts=mesh, sha256="0" * 64, credit=None), description.objects[0]
        scene = replace(scene, meshes=(with_surface(own, described.metallic, described.roughness),))
    return scene if radiance is None else replace(scene, environment=radiance)


def sky(rows: int = 8, cols: int = 16) -> Floats:
    """A random coloured map of high contrast, [rows, cols, 3], with a fixed seed."""
    random = np.random.default_rng(20)
    return np.exp(random.normal(size=(rows, cols, 3))).astype(np.float32)


def sun(radiance: float, around: float, rows: int = 16, cols: int = 32) -> Floats:
    """A map [rows, cols, 3] of radiance `around`, with one texel of `radiance` above and right of the camera."""
    texels = np.full((rows, cols, 3), around, np.float32)
    texels[rows // 4, cols // 4] = radiance
    return texels


def broad_sun() -> Floats:
    """A map [16, 32, 3] with a smooth bright region of about a hundred texels, so that its light is spread out."""
    theta, phi = np.meshgrid((np.arange(16) + 0.5) * np.pi / 16, (np.arange(32) + 0.5) * np.pi / 16, indexing="ij")
    towards = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1)
    bright = np.exp(6 * (towards @ (0.77, 0.45, 0.45)))
    return (bright[..., None] * (1.0, 0.9, 0.7) + 0.5).astype(np.float32)
