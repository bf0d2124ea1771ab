"""Point lights of pyrender: inside, on the surface, at infinity, far too strong."""

from math import inf, nan

import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.mesh import FIT_RADIUS

FRONT = {"azimuth": 0.0, "elevation": 0.0}
"""The camera on +z; with an odd size the ray through the middle pixel meets the origin."""


def _renderer(mesh: str = "primitive/sphere", ambient: float = 0.4) -> PyrenderRenderer:
    light = {"points": [{"energy": 30.0, "position": (0.0, 0.0, 3.0)}], "ambient": ambient}
    return PyrenderRenderer(placed(mesh, size=(33, 33), camera=FRONT, lights=light))


def _lit(renderer: PyrenderRenderer, energy: float, position: tuple[float, float, float]) -> Tensor:
    """The picture with the light there; its energy in the group's unit of 30."""
    light = renderer.initial()["illumination"].clone()
    light[1:] = torch.tensor([energy, *position], dtype=light.dtype)
    picture = renderer.render({"illumination": light[None]})[0]
    need(bool(torch.isfinite(picture).all()), "the picture has values that are not finite")
    return picture


def _inside(position: tuple[float, float, float]) -> Measured:
    """A light inside a closed object lights nothing that is seen: the picture is that of no light.

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
    what = f"largest difference from the picture without the light, within the outline; on it {outline:.1%} leak"
    return Measured(float(differs[inner].max()), 0.0, what)


def _opposite() -> Measured:
    """Behind a square seen from the front, exactly on the view axis: light and view are opposite, half-way nowhere."""
    renderer = _renderer("primitive/plane")
    lit, dark = _lit(renderer, 100.0, (0, 0, -2.0)), _lit(renderer, 0.0, (0, 0, -2.0))
    return Measured(float((lit - dark).abs().max()), 0.0, "largest difference from the picture without the light")


def _on() -> Measured:
    """A light in the plane of a square grazes it everywhere: it is as if it were not there."""
    renderer = _renderer("primitive/plane")
    lit, dark = _lit(renderer, 100.0, (0.05, 0.1, 0.0)), _lit(renderer, 0.0, (0, 0, 0))
    return Measured(float((lit - dark).abs().max()), 0.0, "largest difference from the picture without the light")


def _touching() -> Measured:
    """A light just above a square: white below it, and elsewhere in proportion to its height (closed form)."""
    renderer = _renderer("primitive/plane", ambient=0.0)
    picture = _lit(renderer, 1.0, (0.0, 0.0, 1e-4))
    need(bool((picture[16, 16] > 1 - 1e-6).all()), "it is not white below the light")
    found = []
    for height in (1e-4, 2e-4):
        light = torch.tensor([[0.0, 1.0, 0.0, 0.0, height]], dtype=torch.float64)
        found.append(renderer.radiance({"illumination": light})[0, 10:23, 10:13, :3].double())
    need(float(found[0].min()) > 0, "the light does nothing")
    # h / (h² + s²)^1.5 for s of at least 0.2: in proportion to h to 1e-6, and float32 has 1e-3 of h beside z.
    return Measured(
        float((found[1] / found[0] - 2).abs().max()), 1e-2, "distance of a ratio of radiances from 2, closed form"
    )


def _far(distance: float) -> Measured:
    """A far light is a parallel one: the same picture as from twice as far with four times the energy."""
    renderer, near = _renderer(), (distance / 3) ** 2
    first = _lit(renderer, near, (0.6 * distance, 0.0, 0.8 * distance))
    second = _lit(renderer, 4 * near, (1.2 * distance, 0.0, 1.6 * distance))
    dark = _lit(renderer, 0.0, (0, 0, 3))
    need(float((first - dark).abs().max()) > 0.1, "the light does nothing")
    # The sphere's nearest point is closer by its radius: 1/d² changes by twice its share, at most doubled on display.
    limit = max(1e-5, 4 * FIT_RADIUS / distance)
    return Measured(
        float((first - second).abs().max()), limit, "difference from twice as far with four times the energy"
    )


def _linear() -> Measured:
    """Radiance is linear in the light's energy from 1e-30 to 1e6 (closed form)."""
    renderer = _renderer(ambient=0.0)
    found = []
    for energy in (1e-30, 1e6, 1.0):
        light = torch.tensor([[0.0, energy, 1.0, 1.0, 3.0]], dtype=torch.float64)
        found.append(renderer.radiance({"illumination": light})[0, ..., :3].double() / energy)
    need(float(found[2].max()) > 0, "the light does nothing")
    error = max(float((one - found[2]).abs().max() / found[2].max()) for one in found[:2])
    return Measured(error, 1e-5, "relative difference of radiance per energy")


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
    family, dark, parallel = "lights", "as without the light", "a parallel light"
    refused = "the job ends, and says that its numbers are not finite"
    return [
        Case("in the object's centre", family, "d·n < 0 all over; v and l opposite", dark, lambda: _inside((0, 0, 0))),
        Case("just below the surface", family, "1e-3 deep", dark, lambda: _inside((0, 0, FIT_RADIUS - 2e-3))),
        Case("opposite the viewer", family, "v + l = 0: no half vector", dark, _opposite),
        Case("on the surface", family, "1/d² without end, n·l = 0", dark, _on),
        Case("1e-4 above the surface", family, "1/d² = 1e8", "white below it, else ∝ its height", _touching, "clipped"),
        Case("1e4 away", family, "energy 1e8", parallel, lambda: _far(1e4)),
        Case("1e15 away", family, "d² beyond float32's digits", parallel, lambda: _far(1e15)),
        Case("1e25 away", family, "its energy beyond float32", refused, lambda: _far(1e25), "refused", "non-finite"),
        Case("energy of 1e-30 to 1e6", family, "36 orders of magnitude", "radiance is linear", _linear),
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
