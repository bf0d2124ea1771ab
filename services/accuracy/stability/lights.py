"""Light of the pyrender renderer: by its formula; inside, on the surface, at infinity, far too strong."""

from math import inf, nan, pi, sin
from typing import Any

import numpy as np
import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lamps import Lamps, expected
from services.accuracy.stability.shapes import ball
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.mesh import FIT_RADIUS, Part

FRONT = {"azimuth": 0.0, "elevation": 0.0}
"""The camera on +z; with an odd size the ray through the middle pixel meets the origin."""

FORMULA = 2e-6
"""Relative error of a radiance: float32 positions and a dozen float32 products (measured: 5e-7)."""


def _renderer(mesh: str = "primitive/sphere", ambient: float = 0.4) -> PyrenderRenderer:
    light = {"points": [{"energy": 30.0, "position": (0.0, 0.0, 3.0)}], "ambient": ambient}
    return PyrenderRenderer(placed(mesh, size=(33, 33), camera=FRONT, lights=light))


def _lit(renderer: PyrenderRenderer, energy: float, position: tuple[float, float, float]) -> Tensor:
    """The image with the light there; its energy in the group's unit of 30."""
    light = renderer.initial()["illumination"].clone()
    light[1:] = torch.tensor([energy, *position], dtype=light.dtype)
    image = renderer.render({"illumination": light[None]})[0]
    need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
    return image


def _inside(position: tuple[float, float, float]) -> Measured:
    """A light inside a closed object lights nothing that is seen: the image is that of no light.

    On the outline front and back meet, closer than the depth buffer tells apart: there a sample may see the lit inside.
    """
    renderer = _renderer()
    inner = renderer.radiance({})[0, ..., 3] == 1
    shone = _lit(renderer, 1.0, (0, 0, 3)) - _lit(renderer, 0.0, (0, 0, 3))
    need(bool(inner.any()) and float(shone.abs().max()) > 0.1, "the light does nothing outside either")
    differs = torch.zeros(renderer.size)
    for one in (renderer, renderer.exact()):
        differs = differs.maximum((_lit(one, 100.0, position) - _lit(one, 0.0, position)).abs().amax(dim=-1))
    outline = float((differs[~inner] > 0).sum() / inner.sum())
    need(outline < 0.01, f"light leaks on the outline, at {outline:.1%} of the object's pixels")
    what = f"largest difference from the image without the light, within the outline; on it {outline:.1%} leak"
    return Measured(float(differs[inner].max()), 0.0, what)


def _opposite() -> Measured:
    """Behind a square seen from the front, exactly on the view axis: light and view are opposite, half-way nowhere."""
    renderer = _renderer("primitive/plane")
    lit, dark = _lit(renderer, 100.0, (0, 0, -2.0)), _lit(renderer, 0.0, (0, 0, -2.0))
    return Measured(float((lit - dark).abs().max()), 0.0, "largest difference from the image without the light")


def _on() -> Measured:
    """A light in the plane of a square grazes it everywhere: it is as if it were not there."""
    renderer = _renderer("primitive/plane")
    lit, dark = _lit(renderer, 100.0, (0.05, 0.1, 0.0)), _lit(renderer, 0.0, (0, 0, 0))
    return Measured(float((lit - dark).abs().max()), 0.0, "largest difference from the image without the light")


def _against_formula(
    mesh: str | tuple[Part, ...], lamps: Lamps, thing: dict[str, Any] | None = None, spread: float = 1.0
) -> Measured:
    """Radiance and displayed values under any light, where the surface is flat, against their formula.

    `spread`: by how much the relative rounding of what is measured exceeds that of a few float32 products.
    """
    lights = {
        "points": [{}] * len(lamps.points),
        "directional": [{}] * len(lamps.suns),
        "spots": [{"inner_angle": inner, "outer_angle": outer} for inner, outer in lamps.spots[:, 7:]],
    }
    scene = placed(mesh, size=(33, 33), camera={"azimuth": 0.4, "elevation": 0.3}, thing=thing, lights=lights)
    wanted = expected(scene, lamps)
    need(len(wanted.pixels) > 100, f"only {len(wanted.pixels)} pixels are flat")
    brightest = float(wanted.radiance.max())
    need(brightest > 0, "the light does nothing by its formula")
    renderer = PyrenderRenderer(scene)
    coordinates = [kind.copy() for kind in (lamps.points, lamps.suns, lamps.spots[:, :7])]
    for kind, unit in zip(coordinates, (30, 3, 30), strict=True):  # the group's units of energy
        kind[:, 0] /= unit
    values = [lamps.ambient, *(value for kind in coordinates for value in kind.ravel())]
    light = torch.tensor([values], dtype=torch.float64)
    worst = 0.0
    for one in (renderer, renderer.exact()):
        radiance = one.radiance({"illumination": light})[0].reshape(-1, 4)[wanted.pixels, :3].double().numpy()
        shown = one.render({"illumination": light})[0].reshape(-1, 3)[wanted.pixels].double().numpy()
        worst = max(worst, float(np.abs(radiance - wanted.radiance).max()) / brightest)
        worst = max(worst, float(np.abs(shown - wanted.shown).max()))
    what = f"largest error of radiance (relative to the brightest) and of displayed values; {len(wanted.pixels)} pixels"
    return Measured(worst, spread * FORMULA, what)


def _touching() -> Measured:
    """A light just above a square: white below it, and elsewhere in proportion to its height."""
    renderer = _renderer("primitive/plane", ambient=0.0)
    image = _lit(renderer, 1.0, (0.0, 0.0, 1e-4))
    need(bool((image[16, 16] > 1 - 1e-6).all()), "it is not white below the light")
    scene = placed("primitive/plane", size=(33, 33), camera=FRONT)
    light = [30.0, 0.0, 0.0, 1e-4]
    pixels = (33 * np.arange(10, 23)[:, None] + np.arange(10, 13)).ravel()
    wanted = expected(scene, Lamps(0.0, np.array([light])), pixels)
    need(len(wanted.pixels) == len(pixels), "a pixel is not flat")
    given = torch.tensor([[0.0, 1.0, *light[1:]]], dtype=torch.float64)
    found = renderer.radiance({"illumination": given})[0].reshape(-1, 4)[wanted.pixels, :3].double().numpy()
    error = float(np.abs(found / wanted.radiance - 1).max())
    return Measured(error, 5 * FORMULA, "relative error of radiance, against the formula; the square lies in z = 0")


def _far(distance: float) -> Measured:
    """A far light is a parallel one, with the radiance of the formula."""
    energy = 30 * (distance / 3) ** 2
    lamp = np.array([[energy, 0.6 * distance, 0.3 * distance, 0.8 * distance]])
    return _against_formula("primitive/cube", Lamps(0.1, lamp))


def _falls_off() -> Measured:
    """A light straight before a square, twice as far with four times the energy: the same in the middle, and there
    energy / (π d²) and the coat's reflectance straight on, F₀ / (4 π α²) of the irradiance."""
    renderer = _renderer("primitive/plane", ambient=0.0)
    worst = 0.0
    for energy, distance in ((1.0, 0.5), (4.0, 1.0), (16.0, 2.0), (1.0, 3.0)):
        light = torch.tensor([[0.0, energy / 30, 0.0, 0.0, distance]], dtype=torch.float64)
        found = renderer.radiance({"illumination": light})[0, 16, 16, :3].double()
        wanted = energy / distance**2 * (1 / pi + 0.04 / (4 * pi * 0.45**4))
        worst = max(worst, float((found / wanted - 1).abs().max()))
    return Measured(worst, FORMULA, "relative error of the middle's radiance at distances of 0.5 to 3, closed form")


def _sky(up: float) -> Measured:
    """Under the sky alone a white square that faces the camera at elevation `up` has 1 + sin(up) / 3 and its gloss."""
    camera = {"azimuth": 0.0, "elevation": up}
    scene = placed("primitive/plane", size=(33, 33), camera=camera, thing={"rotation": (-up, 0.0, 0.0)})
    dark = torch.tensor([[0.7, 0.0, 0.0, 0.0, 3.0]], dtype=torch.float64)
    found = PyrenderRenderer(scene).radiance({"illumination": dark})[0, 16, 16, :3].double()
    wanted = 0.7 * (1 + sin(up) / 3 + 0.04)
    return Measured(float((found - wanted).abs().max()), FORMULA, "error of the middle's radiance, closed form")


def _linear() -> Measured:
    """Radiance is linear in the light's energy from 1e-30 to 1e6, and at 30 it is that of the formula."""
    scene = placed("primitive/plane", size=(33, 33), camera=FRONT)
    wanted = expected(scene, Lamps(0.0, np.array([[30.0, 1.0, 1.0, 3.0]])))
    renderer = _renderer("primitive/plane", ambient=0.0)
    worst = 0.0
    for energy in (1e-30, 1e6, 1.0):
        light = torch.tensor([[0.0, energy, 1.0, 1.0, 3.0]], dtype=torch.float64)
        found = renderer.radiance({"illumination": light})[0].reshape(-1, 4)[wanted.pixels, :3].double().numpy()
        worst = max(worst, float(np.abs(found / energy / wanted.radiance - 1).max()))
    return Measured(worst, FORMULA, "relative error of radiance per energy, against the formula")


def _strong() -> Measured:
    """Far too strong: white where it shines, and the same white for ten times as much."""
    renderer = _renderer()
    first, second = _lit(renderer, 1e6, (0, 0, 3)), _lit(renderer, 1e7, (0, 0, 3))
    need(bool((first[16, 16] > 1 - 1e-6).all()), "the middle is not white")
    changed = float((first[16, 16] - second[16, 16]).abs().max())
    return Measured(changed, 0.0, "change of the brightest pixel for ten times the energy")


def _refused(energy: float, position: tuple[float, float, float]) -> Measured:
    return Measured(float(_lit(_renderer(), energy, position).max()), -1.0, "brightest displayed value")


def cases() -> list[Case]:
    """The cases of this family."""
    family, dark, formula = "lights", "as without the light", "radiance and image by the formula"
    four = [[30.0, 1.2, 2.0, 1.5], [8.0, -1.0, 0.2, 0.9], [90.0, 0.3, -2.5, 3.0], [2.0, 0.1, 1.0, 0.6]]
    suns = np.array([[2.0, -0.3, -1.0, -0.6], [1.0, 0.5, -0.2, -0.8]])
    spots = np.array(
        [[25.0, -1.0, 0.4, 1.5, 1.1, -0.3, -1.4, 0.1, 0.35], [40.0, 0.3, 1.6, 0.9, -0.5, -3.0, -1.5, 0.0, 0.5]]
    )
    glossy = {"color": (0.8, 0.35, 0.05), "rotation": (0.5, -0.3, 0.2)}
    refused = "the job ends, and says that its numbers are not finite"
    return [
        Case(
            "four lights on a coloured cube",
            family,
            "body, coat, sky and fall-off together",
            formula,
            lambda: _against_formula("primitive/cube", Lamps(0.25, np.array(four)), glossy),
        ),
        Case(
            "suns and spots on a coloured cube",
            family,
            "directions of any length; a cone's edge",
            formula,
            lambda: _against_formula("primitive/cube", Lamps(0.25, np.array(four[:1]), suns, spots), glossy, 3.0),
        ),
        Case(
            "smooth normals on large faces",
            family,
            "interpolated normals of length 0.9",
            formula,
            lambda: _against_formula(ball(0.6), Lamps(0.25, np.array(four)), {"color": (0.8, 0.35, 0.05)}, 5.0),
        ),
        Case(
            "grazing light",
            family,
            "0.5° above a square",
            formula,
            lambda: _against_formula("primitive/plane", Lamps(0.0, np.array([[30.0, 2.0, 0.1, 0.02]])), spread=10),
        ),
        Case("0.5 to 3 away", family, "1/d² from 4 to 1/9", "energy / d² and the gloss straight on", _falls_off),
        Case("sky from above", family, "no other light", "1 + n_y / 3, and the gloss", lambda: _sky(1.2)),
        Case("sky from below", family, "no other light", "1 + n_y / 3, and the gloss", lambda: _sky(-1.2)),
        Case("in the object's centre", family, "d·n < 0 all over; v and l opposite", dark, lambda: _inside((0, 0, 0))),
        Case("just below the surface", family, "1e-3 deep", dark, lambda: _inside((0, 0, FIT_RADIUS - 2e-3))),
        Case("opposite the viewer", family, "v + l = 0: no half vector", dark, _opposite),
        Case("on the surface", family, "1/d² without end, n·l = 0", dark, _on),
        Case("1e-4 above the surface", family, "1/d² = 1e8", "white below it, else the formula", _touching, "clipped"),
        Case("1e4 away", family, "energy 3e8", formula, lambda: _far(1e4)),
        Case("1e15 away", family, "d² beyond float32's digits", formula, lambda: _far(1e15)),
        Case("1e25 away", family, "its energy beyond float32", refused, lambda: _far(1e25), "refused", "non-finite"),
        Case(
            "energy of 1e-30 to 1e6", family, "36 orders of magnitude", "radiance is linear, and the formula's", _linear
        ),
        Case("energy of 3e7", family, "10,000 times white", "held at white", _strong, "clipped"),
        Case(
            "infinite energy",
            family,
            "not a number",
            refused,
            lambda: _refused(inf, (0, 0, 3)),
            "refused",
            "non-finite",
        ),
        Case(
            "NaN position", family, "not a number", refused, lambda: _refused(1.0, (nan, 0, 3)), "refused", "non-finite"
        ),
        Case(
            "energy beyond float32", family, "1e39", refused, lambda: _refused(1e39, (0, 0, 3)), "refused", "non-finite"
        ),
    ]
