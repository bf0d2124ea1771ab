"""Normals at the poles of their angles, on the view axis, edge-on, and turned away."""

from math import pi

import numpy as np
import torch
from torch import Tensor

from services.accuracy.placing import TABLES, placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lobes import of_one_lobe
from services.accuracy.stability.shading import GRADIENT, Shading
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer.table import to_angles, to_vectors


def _all_at(shading: Shading, azimuth: float, polar: float) -> Tensor:
    """Normals [H, W, 2], every pixel's the same."""
    return torch.tensor([azimuth, polar]).expand(*shading.renderer.size, 2).contiguous()


def _image(azimuth: float, polar: float, kappa: float = 1.0, gamma: float = 50.0) -> Measured:
    """An image whose normals all have these angles: the renderer is compiled for other ones."""
    shading = Shading.of(placed(radiance=sky(), size=TABLES))
    parameters = {"normals": _all_at(shading, azimuth, polar), "material": of_one_lobe(kappa, gamma)}
    found = shading.errors(parameters)
    return found.within(shading.due, "largest error of a displayed value, against the definition in float64")


def _gradient(azimuth: float, polar: float) -> Measured:
    shading = Shading.of(placed(radiance=0.2 * sky()))
    parameters = {"normals": _all_at(shading, azimuth, polar), "material": of_one_lobe(0.3, 1.0)}
    covered = (shading.gbuffer.coverage > 0)[..., None].expand(-1, -1, 2)
    error = shading.gradient_error(parameters, "normals", 1e-4, covered)
    return Measured(error, GRADIENT, "relative error of the gradient, against differences of the definition")


def _pole(polar: float) -> Measured:
    """At the pole the azimuth has no meaning: moving it moves nothing, and its gradient is zero."""
    shading = Shading.of(placed(radiance=0.2 * sky()))
    parameters = {"normals": _all_at(shading, 0.0, polar), "material": of_one_lobe(0.3, 1.0)}
    turned = parameters | {"normals": _all_at(shading, 1.3, polar)}
    with torch.no_grad():
        images = [shading.renderer.render({g: v[None] for g, v in p.items()}) for p in (parameters, turned)]
    gradient, _ = shading.gradient(parameters, "normals")
    need(float(gradient[..., 1].abs().max()) > 0, "the gradient of the polar angle is zero too")
    gradients = float(gradient[..., 0].abs().max() / gradient[..., 1].abs().max())
    moved = float((images[0] - images[1]).abs().max())
    # float32's π is off by 9e-8, so sin(polar) is 9e-8 and not 0.
    return Measured(
        max(moved, gradients), 1e-5, "change of the image under the azimuth, and its gradient against the polar's"
    )


def _there_and_back() -> Measured:
    """Vectors on every axis, beside every pole and beside the jump of the azimuth, to angles and back, in float32."""
    tiny = [0.0, 1e-30, 1e-12, 1e-7, 1e-3]
    points = [
        np.roll([sign, a, b], turn)
        for sign in (1.0, -1.0)
        for turn in range(3)
        for a in tiny
        for b in (0.0, *tiny, -1e-7)
    ]
    vectors = np.array(points, np.float64)
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    angles = to_angles(torch.tensor(vectors, dtype=torch.float32))
    need(bool(torch.isfinite(angles).all()), "an angle is not finite")
    need(bool((angles[:, 0].abs() <= np.float32(pi)).all()), "an azimuth is beyond π")
    back = to_vectors(angles.double()).numpy()
    return Measured(
        float(np.abs(back - unit).max()), 5e-7, "distance of the unit vector that comes back; π is 3e-7 in float32"
    )


def _edge_on() -> Measured:
    """A square turned to 0.6° from edge-on, seen from the front: what is still covered has a normal to the viewer."""
    scene = placed(
        "primitive/plane",
        size=(64, 64),
        camera={"azimuth": 0.0, "elevation": 0.0},
        thing={"rotation": (0, pi / 2 - 0.01, 0)},
    )
    seen = rasterise(scene)
    covered = seen.coverage > 0
    need(bool(covered.any()), "nothing is covered")
    normals = seen.normals[covered].double().numpy()
    need(bool(np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-6), "a normal is not of length 1")
    need(bool((normals @ scene.view[:3, 2] > -1e-2).all()), "a normal is turned away from the viewer")
    # The plane's own normal, turned as the object is.
    wanted = np.array([np.sin(pi / 2 - 0.01), 0.0, np.cos(pi / 2 - 0.01)])
    off = np.minimum(np.linalg.norm(normals - wanted, axis=1), np.linalg.norm(normals + wanted, axis=1))
    return Measured(
        float(off.max()), 1e-5, "distance to the square's own normal; a normal beyond the horizon is put on it"
    )


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "normals", "the loop's image is within its tolerance, the exact image within rounding"
    right, away = "the gradient is that of the definition", pi
    return [
        Case("upper pole", family, "polar angle 0", same, lambda: _image(0.0, 0.0)),
        Case("lower pole", family, "polar angle π", same, lambda: _image(0.0, pi)),
        Case(
            "azimuth at the upper pole",
            family,
            "an angle without meaning",
            "it moves nothing and has no gradient",
            lambda: _pole(0.0),
        ),
        Case(
            "azimuth at the lower pole",
            family,
            "an angle without meaning",
            "it moves nothing and has no gradient",
            lambda: _pole(pi),
        ),
        Case("gradient beside the pole", family, "polar angle 1e-3", right, lambda: _gradient(0.7, 1e-3)),
        Case("view axis", family, "n = v exactly, where θ_h and θ_d meet", same, lambda: _image(0.0, pi / 2)),
        Case("gradient on the view axis", family, "n = v exactly", right, lambda: _gradient(0.0, pi / 2)),
        Case("grazing", family, "n·v = 1e-6", same, lambda: _image(pi / 2 - 1e-6, pi / 2)),
        Case("gradient when grazing", family, "n·v = 1e-3", right, lambda: _gradient(pi / 2 - 1e-3, 1.2)),
        Case("back-facing", family, "n = −v: n·h is never positive", same, lambda: _image(away, pi / 2, 0.3, 0.05)),
        Case(
            "back-facing, oblique",
            family,
            "n·v = −0.5, lit from behind",
            same,
            lambda: _image(2 * pi / 3, pi / 2, 0.3, 1.0),
        ),
        Case("angles of 1e3", family, "160 turns: float32 has 6e-5 radians left", same, lambda: _image(1000.0, 1000.0)),
        Case("vector to angles and back", family, "axes, poles, ±π", "the same vector comes back", _there_and_back),
        Case("edge-on square", family, "0.6° from edge-on", "unit normals towards the viewer", _edge_on),
    ]
