"""Objects that are tiny, huge, hidden, cut off or not there."""

from math import pi
from typing import Any

import numpy as np
import torch

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lamps import expected
from services.accuracy.stability.rays import cast
from services.rendering.factory import build
from services.rendering.opengl.gbuffer import FACTOR, GBuffer, rasterise
from services.rendering.protocol import Renderer
from services.scenes.mesh import FIT_RADIUS
from services.scenes.resolve import ResolvedScene
from services.scenes.view import camera_to_world

EDGES = 0.02
"""Share of covered samples that may differ from the rays': those within rounding of an edge."""

SURFACE = 1e-4
"""Error of what a covered pixel holds of the surface (normal, base colour; depth, relative): float32 throughout, over
the frame's depth range. Pixels at edges inside the object may have more, as many as EDGES of them."""

CUBE = FIT_RADIUS / 3**0.5
"""Half the side of a cube of scale 1."""

SHOWN = 2e-6
"""Error of a displayed value of pyrender's: a dozen float32 products."""


def sound(scene: ResolvedScene) -> GBuffer:
    """The G-buffer, with what must hold of any: unit normals; all finite."""
    seen = rasterise(scene)
    for name in ("normals", "base_color", "depth", "coverage"):
        need(bool(torch.isfinite(getattr(seen, name)).all()), f"{name} has values that are not finite")
    normals = seen.normals[seen.coverage > 0].double().numpy()
    need(bool(np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5), "a normal is not of length 1")
    return seen


def against_rays(scene: ResolvedScene, covered: bool = False) -> Measured:
    """The rasterised coverage, depth, normals and base colours against rays through each sample.

    `covered`: every pixel must be, wholly.
    """
    seen = sound(scene)
    found = cast(scene, FACTOR)
    share = found.coverage.reshape(seen.coverage.shape)
    need(share.sum() > 0, "no ray meets anything")
    ours = seen.coverage.double().numpy()
    need(not covered or ours.min() == share.min() == 1, "a pixel is not wholly covered")
    off = float(np.abs(ours - share).sum() / share.sum())
    both = ((share == 1) & (ours == 1)).ravel()
    if both.any():
        wanted = found.mean(found.normals)[both]
        leaning = np.linalg.norm(wanted, axis=1) > 0.5  # the mean of opposite normals has no direction
        wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
        far = np.linalg.norm(seen.normals.reshape(-1, 3).double().numpy()[both] - wanted, axis=1)[leaning]
        depth = found.mean(found.depth)[both]
        deep = np.abs(seen.depth.double().numpy().ravel()[both] - depth) / depth
        color = np.abs(seen.base_color.reshape(-1, 3).double().numpy()[both] - found.mean(found.colors)[both])
        for name, error in (("depths", deep), ("normals", far), ("base colours", color)):
            typical = float(np.quantile(error, 1 - EDGES))
            need(typical < SURFACE, f"{name} are off by {typical:.1e}")
    return Measured(off, EDGES, "share of covered samples that differ from a ray through each, in float64")


def drawn_by(scene: ResolvedScene, name: str) -> tuple[Renderer, Renderer]:
    """The renderer of that name, and its exact twin."""
    renderer = build(scene, name)
    return renderer, renderer.exact()


def _filled(mesh: str, thing: dict[str, Any], camera: dict[str, float]) -> Measured:
    """In front of, and inside, an object that is all there is to see; drawn by both renderers."""
    scene = placed(mesh, thing=thing, camera=camera)
    against_rays(scene, covered=True)
    wanted = expected(scene)
    need(len(wanted.pixels) > 100, f"only {len(wanted.pixels)} pixels are flat")
    drawn = drawn_by(scene, "pyrender")
    shown = [one.render({})[0].reshape(-1, 3)[wanted.pixels].double().numpy() for one in drawn]
    error = max(float(np.abs(image - wanted.shown).max()) for image in shown)
    return Measured(error, SHOWN, "largest error of pyrender's image against its formula; G-buffer as rays have it")


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
    family, rays = "views", "coverage, depth, normals and colours as rays have them"
    filled = "all covered, the surface as rays have it, pyrender's image by its formula"
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
            filled,
            lambda: _filled("primitive/cube", {"scale": 2.0, "translation": (0, 0, 1.77 - 2 * CUBE)}, front),
        ),
        Case(
            "camera inside the object",
            family,
            "only back faces are seen",
            filled,
            lambda: _filled("primitive/cube", {"scale": 8.0, "rotation": (0.2, 0.3, 0.1)}, {}),
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
