"""The image of one object by a second program: a loop over pixels, from the formulas of docs/reports/materials.md.

It shares no code with scene_attack.rendering. Texels are averaged from the map's file, directions, solid angles, half
vectors, material curves and exposure are computed anew, in world space, where the renderer works in the camera's; and
normals come from rays through the triangles. All in numpy's long double (80 bits on x86), so that what it differs from
float64 by is float64's. Derivatives are complex steps (Squire and Trapp 1998): no difference is taken, nothing cancels.
"""

from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene_attack.scenes.mesh import Doubles, Floats
from scene_attack.scenes.resolve import ResolvedScene

Wide = NDArray[np.longdouble]
Number = NDArray[Any]
"""Real or complex (for a complex step) long doubles."""

PI = np.arccos(np.longdouble(-1))
MEAN_INTENSITY, WHITE, MATERIAL_UNIT = 10, np.longdouble("0.9"), 30
LEAST_COSINE, LEAST_EXPONENT, LARGEST_EXPONENT = np.longdouble("1e-4"), -40, np.log(np.longdouble(20))
SAMPLES = 4
"""Samples a side of a pixel, whose normals are averaged."""
STEP = 1e-30
"""Of complex steps."""


def texels(source: Floats, rows: int, cols: int) -> Floats:
    """Means over the solid angles of the texels of a `rows` × `cols` map [rows, cols, 3], of a map of whole multiples
    of that size."""
    height, width = source.shape[0] // rows, source.shape[1] // cols
    edges = np.cos(PI * np.arange(source.shape[0] + 1) / source.shape[0])
    areas = edges[:-1] - edges[1:]
    found = np.zeros((rows, cols, 3), np.longdouble)
    for row in range(rows):
        band = slice(row * height, (row + 1) * height)
        for col in range(cols):
            block = source[band, col * width : (col + 1) * width].astype(np.longdouble).mean(axis=1)
            found[row, col] = (block * areas[band, None]).sum(axis=0) / areas[band].sum()
    return found.astype(np.float32)


class Light:
    """Directions [D, 3], in world space, and radiance times solid angle of one unit of intensity, [D, 3]."""

    def __init__(self, radiance: Floats) -> None:
        """`radiance` [rows, cols, 3] is lit."""
        rows, cols, _ = radiance.shape
        self.towards, solid = _sphere(rows, cols)
        flat = radiance.reshape(-1, 3).astype(np.longdouble)
        luminance = flat @ np.array(["0.2126", "0.7152", "0.0722"], np.longdouble)
        chroma = np.where(luminance[:, None] > 0, flat / np.where(luminance > 0, luminance, 1)[:, None], 1)
        self.intensity = luminance * MEAN_INTENSITY * 4 * PI / (luminance * solid).sum()
        probes, _ = _sphere(16, 32)
        white = np.maximum(probes @ self.towards.T, 0) @ (chroma * (self.intensity * solid)[:, None]) / PI
        self.power = chroma * solid[:, None] * WHITE / white.max()


def normals_of(angles: Number, view: Doubles) -> Number:
    """Unit normals [P, 3], in world space, of azimuth and polar angle [P, 2] in the frame of the camera `view`."""
    right, up, back = (view[:3, k].astype(np.longdouble) for k in range(3))
    azimuth, polar = angles[:, :1], angles[:, 1:]
    vectors: Number = (
        np.sin(polar) * np.sin(azimuth) * right + np.cos(polar) * up + np.sin(polar) * np.cos(azimuth) * back
    )
    return vectors


def displayed(
    light: Light, view: Doubles, normals: Number, intensity: Number, material: Number, base_color: Wide
) -> Number:
    """Displayed colours [P, 3] of pixels with `normals` [P, 3] and `base_color` [P, 3] under intensities [D], of a
    material [3, 3, 2, 6] in the units of its group. Complex where an argument is."""
    viewer = view[:3, 3].astype(np.longdouble)
    viewer = viewer / np.sqrt((viewer**2).sum())
    half = light.towards + viewer
    length = np.sqrt((half**2).sum(axis=1))
    behind = length < 1e-7
    half = np.where(behind[:, None], 0, half / np.where(behind, 1, length)[:, None])
    theta_d = np.where(behind, PI / 2, np.arccos(np.minimum((half * light.towards).sum(axis=1), 1)))
    t = theta_d / (PI / 2)
    basis = np.stack([comb(5, i) * t**i * (1 - t) ** (5 - i) for i in range(6)])
    colours = []
    for normal, base in zip(normals, base_color, strict=True):
        cosine, log_half = light.towards @ normal, half @ normal
        log_half = np.log(np.where(log_half.real > LEAST_COSINE, log_half, LEAST_COSINE))
        lit = cosine.real > 0
        for channel in range(3):
            rho: Number = np.zeros(len(t), np.longdouble)
            for lobe in range(3):
                log_kappa, log_gamma = (material[channel, lobe] / MATERIAL_UNIT) @ basis
                exponent = log_kappa + np.exp(log_gamma) * log_half
                exponent = np.where(exponent.real > LEAST_EXPONENT, exponent, LEAST_EXPONENT)
                exponent = np.where(exponent.real < LARGEST_EXPONENT, exponent, LARGEST_EXPONENT)
                rho = rho + np.expm1(np.exp(exponent))
            sent = rho * cosine * light.power[:, channel] * intensity
            colours.append(_srgb(base[channel] * sent[lit].sum()))
    return np.array(colours).reshape(-1, 3)


def normals_by_rays(scene: ResolvedScene, pixels: NDArray[np.int64]) -> tuple[Doubles, NDArray[np.bool_]]:
    """Unit normals [P, 3] of flat pixel indices [P] in world space, from a scene of one opaque object, and whether all
    samples of the pixel met it [P]. Each ray by Möller and Trumbore (1997), the mean over the samples made unit."""
    height, width = scene.description.camera.size
    tangent = np.tan(scene.description.camera.field_of_view / 2)
    right, up, back, eye = (scene.view[:3, k] for k in range(4))
    offset = (np.arange(SAMPLES) + 0.5) / SAMPLES
    y = (1 - 2 * (pixels[:, None] // width + offset) / height) * tangent
    x = (2 * (pixels[:, None] % width + offset) / width - 1) * tangent * width / height
    rays = x[:, None, :, None] * right + y[:, :, None, None] * up - back
    rays = rays.reshape(-1, 3)
    depth, normals = np.full(len(rays), np.inf), np.zeros((len(rays), 3))
    [mesh], [model] = scene.meshes, scene.models
    for part in mesh.parts:
        corners = part.vertices.astype(np.float64) @ model[:3, :3].T + model[:3, 3] - eye
        turned = part.normals.astype(np.float64) @ np.linalg.inv(model[:3, :3])
        for face in part.faces:
            a, b, c = corners[face]
            across = rays @ np.cross(b - a, c - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (a @ np.cross(b - a, c - a)) / across
                u, v = rays @ np.cross(c - a, a) / across, -(rays @ np.cross(b - a, a)) / across
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < depth)
            at = (
                (1 - u - v)[hit, None] * turned[face[0]]
                + u[hit, None] * turned[face[1]]
                + v[hit, None] * turned[face[2]]
            )
            depth[hit] = t[hit]
            normals[hit] = at / np.linalg.norm(at, axis=1, keepdims=True)
    normals *= np.where((normals * rays).sum(axis=1, keepdims=True) > 0, -1, 1)  # towards the viewer
    samples = normals.reshape(len(pixels), SAMPLES**2, 3).mean(axis=1)
    whole = np.isfinite(depth).reshape(len(pixels), -1).all(axis=1)
    return samples / np.maximum(np.linalg.norm(samples, axis=1, keepdims=True), 1e-300), whole


def _sphere(rows: int, cols: int) -> tuple[Wide, Wide]:
    """Directions [rows · cols, 3] of texel centres and their solid angles [rows · cols]."""
    directions, solid = np.empty((rows * cols, 3), np.longdouble), np.empty(rows * cols, np.longdouble)
    for place in range(rows * cols):
        row, col = divmod(place, cols)
        polar, azimuth = (row + np.longdouble(0.5)) * PI / rows, (col + np.longdouble(0.5)) * 2 * PI / cols
        directions[place] = np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)
        solid[place] = (np.cos(row * PI / rows) - np.cos((row + 1) * PI / rows)) * 2 * PI / cols
    return directions, solid


def _srgb(linear: Any) -> Any:
    """IEC 61966-2-1, clipped to [0,1]."""
    if linear.real <= 0 or linear.real >= 1:
        return linear * 0 + (1 if linear.real >= 1 else 0)
    if linear.real <= np.longdouble("0.0031308"):
        return linear * np.longdouble("12.92")
    return np.longdouble("1.055") * linear ** (1 / np.longdouble("2.4")) - np.longdouble("0.055")
