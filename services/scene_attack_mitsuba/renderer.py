"""The renderer `mitsuba`: a frame as Mitsuba's scene, and its image.

Mitsuba draws in this process, with its variant scalar_rgb, which compiles nothing. Its surfaces are a diffuse one and a
rough conductor, each of twice its strength, blended half and half: their sum. A conductor whose k is 0 has the Fresnel
term of a dielectric, which at normal incidence is pyrender's.
"""

from collections.abc import Sequence
from functools import cached_property, lru_cache
from math import degrees, pi, tan
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from scene_attack.extras import extra
from scene_attack.process import versions
from scene_attack.rendering.plan import Item
from scene_attack.rendering.pyrender.path_tracer import Array, Frame, PathTracer
from scene_attack.scenes.mesh import Bytes, Floats, Part
from scene_attack.scenes.solids import has_holes
from scene_attack.scenes.view import NEAR
from scene_attack_mitsuba.plugin import MITSUBA

COAT_ROUGHNESS, NORMAL_REFLECTANCE, MIN_ROUGHNESS = 0.45, 0.04, 0.04
"""As in pyrender's shaders."""
MAX_REFLECTANCE = 0.999
"""Reflectance at normal incidence above which an index of refraction would be infinite."""
SKY_ROWS = 128
"""Rows of the sky's map, between which it is interpolated: off by at most 1e-4."""
FALL_OFF = 256
"""Texels a side of the fall-off of a spot light, from its axis to its edge and beyond."""
WIDEST = 1.5
"""Largest outer angle of a spot light, radians: its map is flat."""
SUN_DISTANCE = 1000.0
"""Distance of the disc that a sun of some size is, scene units."""
WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
"""Mitsuba's words for OpenGL's wrap modes."""


@lru_cache(maxsize=1)
def modules() -> tuple[Any, Any]:
    """Mitsuba with its variant, and its arithmetic, which has the threads."""
    with extra("mitsuba", "the renderer mitsuba", "attack.renderer"):
        import drjit
        import mitsuba
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba, drjit


def mitsuba() -> Any:
    """Mitsuba, with as many threads as torch has."""
    program, arithmetic = modules()
    if arithmetic.thread_count() != torch.get_num_threads():
        arithmetic.set_thread_count(torch.get_num_threads())
    return program


class MitsubaRenderer(PathTracer):
    """Images by Mitsuba's path tracer on the CPU."""

    declaration = MITSUBA

    @property
    def tracer(self) -> str:
        """Mitsuba, with its version."""
        return f"Mitsuba {versions('mitsuba')['mitsuba']} scalar_rgb"

    def trace(self, frame: Frame) -> NDArray[np.float32]:
        """Draws the frame."""
        mi = mitsuba()
        scene = {"type": "scene", "integrator": self._integrator, "sensor": self._sensor(frame)}
        scene |= self._lights(frame)
        for k, (placed, pose, color) in enumerate(zip(self.scene.placed, frame.poses, frame.colors, strict=True)):
            for number, part in enumerate(placed.mesh.parts):
                scene[f"thing {k} part {number}"] = _mesh(part, pose, color)
        image = mi.render(mi.load_dict(scene), spp=self.samples, seed=self.seed)
        return np.ascontiguousarray(np.array(image, np.float32).reshape(*self.size, 4))

    def unmapped(self) -> Sequence[Item]:
        """What Mitsuba has no surface or light for."""
        items = list(super().unmapped())
        described = self.scene.description
        lights = described.lights
        lamps = len(lights.points) + len(lights.directional) + len(lights.spots)
        if described.shadows is None and lamps:
            items.append(Item(what="lights without shadows", kept=0, of=lamps, why="every light of Mitsuba casts some"))
        if described.shadows is not None and lights.spots:
            why = "their shadows are hard: a spot light of Mitsuba is a point"
            items.append(Item(what="sizes of spot lights", kept=0, of=len(lights.spots), why=why))
        for placed in self.scene.placed:
            surfaces = [part.metallic_roughness for part in placed.mesh.parts if part.metallic_roughness is not None]
            for name in ("metallic_roughness", "normal", "emissive"):
                maps = sum(name in surface.maps for surface in surfaces)
                why = "left out: the surface is that of the factors alone"
                if maps:
                    items.append(Item(part=placed.name, what=f"{name} maps", kept=0, of=maps, why=why))
            thin = sum(part.metallic_roughness is None and part.color[3] < 1 for part in placed.mesh.parts)
            if thin:
                why = "as transparent as their body"
                items.append(Item(part=placed.name, what="coats of transparent parts", kept=0, of=thin, why=why))
            for what, count in (
                ("emission", sum(any(surface.emissive) for surface in surfaces)),
                ("culled backs", sum(not surface.double_sided for surface in surfaces)),
                ("vertex colours", sum(bool((surface.vertex_colors != 1).any()) for surface in surfaces)),
            ):
                if count:
                    why = "drawn" if what == "culled backs" else "left out"
                    items.append(Item(part=placed.name, what=what, kept=0, of=count, why=why))
        return items

    @cached_property
    def _integrator(self) -> dict[str, Any]:
        # A depth of 1 sees emitters, of 2 the surfaces that these light. No path is ended at random. The integrator
        # `path` loses what a surface reflects of the paths that pass it and meet nothing else.
        return {"type": "volpath", "max_depth": self.bounces + 2, "rr_depth": 10_000, "hide_emitters": True}

    def _sensor(self, frame: Frame) -> dict[str, Any]:
        height, width = self.size
        camera, far = self.scene.description.camera, self.scene.projection[2, 3] / (self.scene.projection[2, 2] + 1)
        return {
            "type": "perspective",
            "fov": degrees(camera.field_of_view),
            "fov_axis": "y",
            "near_clip": NEAR,
            "far_clip": float(far),
            "to_world": _transform(frame.camera @ np.diag([-1.0, 1.0, -1.0, 1.0])),  # Mitsuba's looks along +z
            "film": {
                "type": "hdrfilm",
                "height": height,
                "width": width,
                "pixel_format": "rgba",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        }

    def _lights(self, frame: Frame) -> dict[str, Any]:
        shadows = self.scene.description.shadows
        softness, angle = (0.0, 0.0) if shadows is None else (shadows.softness, shadows.angle)
        heights = np.cos(np.linspace(0, pi, SKY_ROWS))
        sky = np.broadcast_to(frame.ambient * (1 + heights / 2)[:, None, None], (SKY_ROWS, 4, 3))
        # A path looks at one light at random: one that is dark would only add noise.
        lights: dict[str, Any] = {}
        if frame.ambient:
            lights["sky"] = {"type": "envmap", "bitmap": mitsuba().Bitmap(sky.astype(np.float32))}
        for k, (intensity, *place) in enumerate(frame.points.tolist()):
            lights[f"point {k}"] = _lamp(place, intensity, softness)
        for k, (irradiance, *towards) in enumerate(frame.directionals.tolist()):
            lights[f"directional {k}"] = _sun(np.array(towards), irradiance, angle)
        angles = [light.outer_angle for light in self.scene.description.lights.spots]
        for k, (values, outer) in enumerate(zip(frame.spots, angles, strict=True)):
            lights[f"spot {k}"] = _spot(values, min(outer, WIDEST))
        return lights


def _transform(matrix: Array) -> Any:
    return mitsuba().ScalarTransform4f(matrix)


def _strength(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [value] * 3}  # a spectrum of one value would not be white


def _lamp(place: list[float], intensity: float, radius: float) -> dict[str, Any]:
    """A point light, or a sphere of its intensity."""
    if radius == 0:
        return {"type": "point", "position": place, "intensity": _strength(intensity)}
    emitter = {"type": "area", "radiance": _strength(intensity / (pi * radius**2))}
    return {"type": "sphere", "center": place, "radius": radius, "emitter": emitter}


def _sun(towards: Array, irradiance: float, angle: float) -> dict[str, Any]:
    """Parallel light, or a far disc of that angular radius."""
    if angle == 0 or irradiance == 0:
        return {"type": "directional", "direction": (-towards).tolist(), "irradiance": _strength(irradiance)}
    size = tan(angle)
    emitter = {"type": "area", "radiance": _strength(irradiance * (1 + size**2) / (pi * size**2))}
    facing = _facing(SUN_DISTANCE * towards, -towards) @ np.diag([SUN_DISTANCE * size, SUN_DISTANCE * size, 1.0, 1.0])
    return {"type": "disk", "to_world": _transform(facing), "emitter": emitter}


def _spot(values: Array, outer: float) -> dict[str, Any]:
    """A light of glTF's fall-off, which is its texture: Mitsuba's own fall-off is another one."""
    intensity, place, axis, scale, offset = values[0], values[1:4], values[4:7], values[7], values[8]
    if not axis.any():
        intensity, axis = 0.0, np.array([0.0, 0.0, 1.0])
    across = np.linspace(-tan(outer), tan(outer), FALL_OFF)
    cosine = 1 / np.sqrt(1 + across[:, None] ** 2 + across**2)
    shares = np.clip(scale * cosine + offset, 0, 1) ** 2
    return {
        "type": "spot",
        "to_world": _transform(_facing(place, axis)),
        "intensity": _strength(float(intensity)),
        "cutoff_angle": degrees(outer),
        "beam_width": degrees(outer),
        "texture": _texture(np.repeat(shares[..., None], 3, axis=-1), "clamp"),
    }


def _facing(place: Array, direction: Array) -> Array:
    """A frame [4, 4] at a place whose +z has a direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1], frame[:3, 2], frame[:3, 3] = x, np.cross(z, x), z, place
    return frame


def _texture(texels: NDArray[Any], wrap: str) -> dict[str, Any]:
    """A texture of linear values, which may be above 1: a [h, w, 1 or 3] array, the first row at the top."""
    bitmap = mitsuba().Bitmap(np.ascontiguousarray(texels, np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": wrap}


def _mesh(part: Part, pose: Array, color: Array) -> Any:
    """A part in world space, with its surface."""
    mi = mitsuba()
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(_surface(part, color))
    surface = part.metallic_roughness
    uv = part.uv
    if surface is not None and "base_color" in surface.maps and surface.maps["base_color"].uv_set == 1:
        uv = surface.second_uv
    mesh = mi.Mesh("part", len(part.vertices), len(part.faces), properties, True, uv is not None)
    values = mi.traverse(mesh)
    normals = part.normals @ np.linalg.inv(pose[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    values["vertex_positions"] = (part.vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32).ravel()
    values["vertex_normals"] = normals.astype(np.float32).ravel()
    values["faces"] = part.faces.astype(np.uint32).ravel()
    if uv is not None:
        values["vertex_texcoords"] = (uv * [1, -1] + [0, 1]).astype(np.float32).ravel()  # Mitsuba's v grows downwards
    values.update()
    return mesh


def _surface(part: Part, color: Array) -> dict[str, Any]:
    """A part's surface. What its texture and its factor on its own colours make of it is computed texel by texel."""
    surface = part.metallic_roughness
    texels, wrap = part.texture if part.uv is not None else None, "repeat"
    if surface is not None and "base_color" in surface.maps:
        texels, wrap = surface.maps["base_color"].texels, WRAPS[surface.maps["base_color"].wrap[0]]
    if texels is None:
        texels = np.full((1, 1, 4), 255, np.uint8)
    base = _linear(texels) * (part.color[:3] * color)
    alpha = texels[..., 3:] / 255
    if surface is None:
        body, reflectance, roughness = base, np.full_like(base, NORMAL_REFLECTANCE), COAT_ROUGHNESS
        opacity = np.full_like(alpha, part.color[3])
        if has_holes(part):
            opacity = opacity * (alpha >= 0.5)
    else:
        metallic, roughness = surface.metallic, max(surface.roughness, MIN_ROUGHNESS)
        reflectance = metallic * base + (1 - metallic) * NORMAL_REFLECTANCE
        body = (1 - metallic) * (1 - NORMAL_REFLECTANCE) * base * (1 - reflectance)
        opacity = alpha * part.color[3]
        if surface.alpha_mode == "MASK":
            opacity = (opacity >= surface.alpha_cutoff).astype(float)
        if surface.alpha_mode == "OPAQUE":
            opacity = np.ones_like(opacity)
    root = np.sqrt(np.minimum(reflectance, MAX_REFLECTANCE))
    closure: dict[str, Any] = {
        "type": "blendbsdf",
        "weight": 0.5,
        "body": {"type": "diffuse", "reflectance": _texture(2 * body, wrap)},
        "reflection": {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": roughness**2,
            "eta": _texture((1 + root) / (1 - root), wrap),
            "k": 0.0,
            "specular_reflectance": _texture(np.full((1, 1, 3), 2.0), wrap),
        },
    }
    closure = {"type": "twosided", "both": closure}
    if (opacity < 1).any():
        return {"type": "mask", "opacity": _texture(opacity, wrap), "what": closure}
    return closure


def _linear(texels: Bytes) -> Floats:
    """The linear colour [h, w, 3] of texels in sRGB (IEC 61966-2-1)."""
    shown = texels[..., :3].astype(np.float64) / 255
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear, np.float32)
