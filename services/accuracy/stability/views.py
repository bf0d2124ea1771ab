"""Objects that are tiny, huge, hidden, cut off or not there."""

from math import pi, tan
from typing import Any

import numpy as np
import torch

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.rays import cast
from services.rendering.factory import build
from services.rendering.opengl.gbuffer import GBuffer, rasterise
from services.scenes.mesh import Doubles
from services.scenes.resolve import ResolvedScene
from services.scenes.view import camera_to_world

EDGES = 0.02
"""Share of covered samples that may differ from the rays': those within rounding of an edge."""

LEANING = 0.1
"""Cosine by which a pixel's mean normal may lean away from the ray through its middle."""


def sound(scene: ResolvedScene) -> GBuffer:
    """The G-buffer, with what must hold of any: unit normals, towards the viewer; all finite."""
    seen = rasterise(scene)
    covered = seen.coverage > 0
    for name in ("normals", "base_color", "depth", "coverage"):
        need(bool(torch.isfinite(getattr(seen, name)).all()), f"{name} has values that are not finite")
    normals = seen.normals[covered].double().numpy()
    need(bool(np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5), "a normal is not of length 1")
    # Each sample's faces it; the mean of a pixel's may lean a little beyond the ray through its middle.
    facing = -(normals * directions(scene)[covered.numpy()]).sum(axis=1)
    need(bool((facing > -LEANING).all()), "a normal is turned away from the viewer")
    return seen


def directions(scene: ResolvedScene) -> Doubles:
    """Unit vectors [H, W, 3] from the eye through the middle of each pixel."""
    height, width = scene.description.camera.size
    slope = tan(scene.description.camera.field_of_view / 2)
    y = (1 - (2 * np.arange(height) + 1) / height) * slope
    x = ((2 * np.arange(width) + 1) / width - 1) * slope * width / height
    rays = x[None, :, None] * scene.view[:3, 0] + y[:, None, None] * scene.view[:3, 1] - scene.view[:3, 2]
    unit: Doubles = rays / np.linalg.norm(rays, axis=2, keepdims=True)
    return unit


def against_rays(scene: ResolvedScene) -> Measured:
    """The rasterised coverage and depth against rays."""
    seen = sound(scene)
    coverage, depth = cast(scene)
    need(coverage.sum() > 0, "no ray meets anything")
    ours = seen.coverage.double().numpy()
    both = (coverage == 1) & (ours == 1)
    error = np.abs(seen.depth.double().numpy() - depth)[both] / depth[both] if both.any() else np.zeros(1)
    need(float(np.quantile(error, 0.99)) < 1e-3, f"depths are off by {np.quantile(error, 0.99):.1e} of themselves")
    off = float(np.abs(ours - coverage).sum() / coverage.sum())
    return Measured(off, EDGES, "share of covered samples that differ from a ray through each, in float64")


def _shown(scene: ResolvedScene, renderer: str) -> torch.Tensor:
    """A picture [H, W, 3], checked to be one."""
    with torch.no_grad():
        picture = build(scene, renderer).render({})[0]
    need(bool(torch.isfinite(picture).all()), "the picture has values that are not finite")
    need(bool((picture >= 0).all() and (picture <= 1).all()), "the picture has values outside [0,1]")
    return picture


def _filled(scale: float) -> Measured:
    """In front of, and inside, an object that is all there is to see."""
    scene = placed(thing={"scale": scale})
    seen = sound(scene)
    pictures = [_shown(scene, name) for name in ("torch", "pyrender")]
    ground = torch.tensor(scene.description.ground)
    need(all(float((p - ground).abs().max()) > 0 for p in pictures), "the picture is all ground")
    return Measured(float((1 - seen.coverage).max()), 0.0, "largest share of a pixel that is not covered")


def _moved_away(distance: float) -> Measured:
    """An attack moves the object out of the picture, sideways and behind the camera: ground is left."""
    scene = placed(camera={"azimuth": 0.0, "elevation": 0.0})
    renderer = build(scene, "pyrender")
    moves = torch.tensor([[[distance, 0.0, 0.0]], [[0.0, 0.0, distance]], [[0.0, -distance, 0.0]]], dtype=torch.float64)
    pictures = renderer.render({"translation": moves})
    need(float((renderer.render({}) - torch.tensor(scene.description.ground)).abs().max()) > 0.01, "it was never there")
    ground = torch.tensor(scene.description.ground, dtype=pictures.dtype)
    return Measured(float((pictures - ground).abs().max()), 0.0, "largest difference from the ground")


def _pole(elevation: float) -> Measured:
    """Straight above or below, where up has no meaning, the view is the limit of views beside it."""
    scene = placed("primitive/cone", camera={"elevation": elevation, "azimuth": 0.7})
    axes = scene.view[:3, :3]
    need(bool(np.abs(axes.T @ axes - np.eye(3)).max() < 1e-12), "the camera's axes are not at right angles")
    beside = scene.description.camera.model_copy(update={"elevation": elevation * (1 - 1e-9)})
    need(bool(np.abs(camera_to_world(beside) - scene.view).max() < 1e-8), "the view jumps at the pole")
    return against_rays(scene)


def _refused(thing: dict[str, Any], camera: dict[str, Any] | None = None) -> Measured:
    placed(size=(64, 64), thing=thing, camera=camera)
    return Measured(1.0, 0.0, "scenes resolved")


def cases() -> list[Case]:
    """The cases of this family."""
    family, rays = "views", "covers what rays meet, at their depth; normals are of length 1"
    front, refused = {"azimuth": 0.0, "elevation": 0.0}, "a clear error names the object"
    floor = {"rotation": (-pi / 2, 0, 0), "translation": (0, -0.5, 0), "scale": 100.0}
    return [
        Case(
            "three pixels across",
            family,
            "scale 0.1 in 32²",
            rays,
            lambda: against_rays(placed("primitive/cube", size=(32, 32), thing={"scale": 0.1})),
        ),
        Case(
            "filling the frame",
            family,
            "0.03 in front of the camera",
            "all covered; torch and pyrender finite",
            lambda: _filled(2.62),
        ),
        Case(
            "camera inside the object",
            family,
            "only back faces are seen",
            "all covered; torch and pyrender finite",
            lambda: _filled(4.0),
        ),
        Case(
            "cut by the near plane",
            family,
            "a floor from behind the camera to far",
            rays,
            lambda: against_rays(placed("primitive/plane", camera=front, thing=floor)),
        ),
        Case(
            "cube around the near plane",
            family,
            "a corner 1e-3 from the eye",
            rays,
            lambda: against_rays(
                placed("primitive/cube", size=(16, 16), camera=front, thing={"translation": (0.1, 0.1, 1.45)})
            ),
        ),
        Case(
            "out of view",
            family,
            "beside the frame",
            refused,
            lambda: _refused(thing={"translation": (50, 0, 0)}),
            "refused",
            "scene.objects.0",
        ),
        Case(
            "behind the camera",
            family,
            "w < 0",
            refused,
            lambda: _refused({"translation": (0, 0, 5)}, front),
            "refused",
            "scene.objects.0",
        ),
        Case(
            "less than a pixel",
            family,
            "scale 1e-3",
            refused,
            lambda: _refused(thing={"scale": 1e-3}),
            "refused",
            "scene.objects.0",
        ),
        Case(
            "moved out of view",
            family,
            "a step of an attack, 1e3 away",
            "exactly the ground is left",
            lambda: _moved_away(1e3),
        ),
        Case("moved 1e15 away", family, "float32 positions", "exactly the ground is left", lambda: _moved_away(1e15)),
        Case("straight above", family, "elevation π/2", rays, lambda: _pole(pi / 2)),
        Case("straight below", family, "elevation −π/2", rays, lambda: _pole(-pi / 2)),
        Case(
            "telephoto",
            family,
            "0.02 radians from 100 away",
            rays,
            lambda: against_rays(
                placed("primitive/torus", camera={"distance": 100.0, "field_of_view": 0.015}, size=(12, 12))
            ),
        ),
        Case(
            "fish eye",
            family,
            "2.8 radians from 0.8 away",
            rays,
            lambda: against_rays(placed("primitive/cube", camera={"distance": 0.9, "field_of_view": 2.8})),
        ),
    ]
