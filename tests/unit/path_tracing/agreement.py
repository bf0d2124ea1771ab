"""Whether the images of a path tracer agree with a reference: a test of every pixel, and how sure it is.

A pixel's mean over independent seeds is compared with the reference by Student's t-test of the null hypothesis that it
is off by no more than what is allowed. The smallest of n p-values is corrected by Šidák (1967) to 1 − (1 − p)^n, as
Mitsuba's tests of renderings do: a right renderer fails one test in a hundred, and with fixed seeds always the same.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from scipy import stats

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.factory import build
from scene_attack.rendering.pyrender.path_traced import PathTracing
from scene_attack.rendering.pyrender.path_tracer import PathTracer
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Camera
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering import shapes

SIGNIFICANCE = 0.01
"""Probability at which a right renderer would fail."""
SEEDS = 8
DENSER = 8
"""Pixels of pyrender's larger image along each side of a pixel."""
MODEL = {"blender": 0.0, "mitsuba": 0.02}
"""Share of the brightest by which a tracer's reflection may differ from pyrender's formula: Mitsuba's Fresnel term is a
dielectric's, and its shadowing is not height-correlated."""
FINER = 8
"""Rays along each side of a pixel of a reference in closed form."""


def tracer(name: str, scene: ResolvedScene, **settings: int) -> PathTracer:
    """The renderer of a scene, with 64 samples and direct light alone unless stated."""
    own = PathTracing(**{"samples": 64, "bounces": 0} | settings)
    renderer = build(scene, name, groups=RENDERERS[name].group_names, settings=own)
    assert isinstance(renderer, PathTracer)
    return renderer


def values_of(renderer: PathTracer, changes: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The scene's own values, and those that `changes` states in their place, as arrays by group."""
    own = {group: value.numpy() for group, value in renderer.initial().items()}
    return own | {group: np.asarray(value, float) for group, value in changes.items()}


def images(renderer: PathTracer, **changes: Any) -> np.ndarray:
    """Linear radiance times coverage, and coverage, under each of the seeds: float64 [SEEDS, H, W, 4]."""
    frame = renderer.frame(values_of(renderer, changes))
    return np.stack([renderer.reseeded(k).trace(frame) for k in range(SEEDS)]).astype(float)


def by_pyrender(scene: ResolvedScene, **changes: Any) -> np.ndarray:
    """The same of the pyrender renderer, drawn by OpenGL: float64 [H, W, 4]. As it shades a pixel once, its image is
    drawn DENSER times as large along each side, and averaged.
    """
    height, width = scene.description.camera.size
    camera = scene.description.camera.model_copy(update={"size": (DENSER * height, DENSER * width)})
    large = replace(scene, description=scene.description.model_copy(update={"camera": camera}))
    parameters = {group: torch.tensor(np.asarray(value, float))[None] for group, value in changes.items()}
    image = PyrenderRenderer(large, tolerance="exact").radiance(parameters)[0].double().numpy()
    return image.reshape(height, DENSER, width, DENSER, 4).mean(axis=(1, 3))


def disagreement(drawn: np.ndarray, reference: np.ndarray, allowed: float | np.ndarray, where: np.ndarray) -> float:
    """The corrected p-value of images [SEEDS, H, W, 3] against a reference [H, W, 3], `where` [H, W] both are whole;
    nothing is known of other pixels. Differences up to `allowed` are no disagreement.
    """
    drawn, reference = drawn[:, where], reference[where]
    allowed = np.broadcast_to(allowed, where.shape)[where][:, None]
    error = np.abs(drawn.mean(axis=0) - reference) - allowed
    deviation = drawn.std(axis=0, ddof=1) / np.sqrt(len(drawn))
    t = error / np.maximum(deviation, 1e-7 * (1 + reference))  # float32 has no smaller noise
    p = stats.t.sf(t, len(drawn) - 1).min()
    return float(-np.expm1(reference.size * np.log1p(-min(p, 0.5))))


def assert_agree(drawn: np.ndarray, reference: np.ndarray, allowed: float | np.ndarray, where: np.ndarray) -> None:
    """Asserts that nothing speaks against agreement, in at least a hundred pixels."""
    assert where.sum() >= 100
    p = disagreement(drawn, reference, allowed, where)
    off = (np.abs(drawn.mean(axis=0) - reference)[where]).max()
    assert p > SIGNIFICANCE, f"p = {p:.3g}; the largest difference of a mean is {off:.3g}"


def unmapped(renderer: PathTracer) -> set[str]:
    """What the renderer's plan says that it does not draw."""
    return {item.what for item in renderer.unmapped()}


def averaged(camera: Camera, radius: float, value: Callable[..., np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Means over pixels [H, W] of `value` (points, normals, eye) of a sphere about the origin, and where it fills them.

    Rays of a finer grid are averaged, FINER along each side of a pixel.
    """
    height, width = camera.size
    eye, ray = shapes.rays(camera.model_copy(update={"size": (FINER * height, FINER * width)}))
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ eye
    root = along**2 - (eye @ eye - radius**2)
    points = eye + ray * (-along - np.sqrt(np.maximum(root, 0)))[..., None]
    blocks = partial(np.reshape, shape=(height, FINER, width, FINER))
    return blocks(value(points, points / radius, eye)).mean(axis=(1, 3)), blocks(root > 0).all(axis=(1, 3))


def inside(*coverages: np.ndarray) -> np.ndarray:
    """Pixels [H, W] that all of these images cover whole, with all pixels beside."""
    whole = np.logical_and.reduce([coverage > 1 - 1e-6 for coverage in coverages])
    padded = np.pad(whole, 1)
    shifts: Sequence[tuple[int, int]] = [(i, j) for i in range(3) for j in range(3)]
    return np.logical_and.reduce([padded[i : i + whole.shape[0], j : j + whole.shape[1]] for i, j in shifts])
