"""Sharp, flat and dark lobes of the material."""

from functools import partial
from math import log

import numpy as np
import torch
from torch import Tensor

from services.accuracy.placing import TABLES, placed, sky, sun
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.linear import linear_problem
from services.accuracy.stability.shading import GRADIENT, SHARP, Shading
from services.rendering.torch_renderer.dsbrdf import LOG_KAPPA_RANGE, MATERIAL_UNIT, SHAPE
from services.scenes.mesh import Floats


def of_one_lobe(kappa: float, gamma: float) -> Tensor:
    """Material group [1, 3, 3, 2, 6] of one lobe with these values at all θ_d; the other two are dark."""
    material = torch.empty(1, *SHAPE, dtype=torch.float64)
    material[..., 0, :], material[..., 1, :] = LOG_KAPPA_RANGE[0], 0.0
    material[:, :, 0, 0], material[:, :, 0, 1] = log(kappa), log(gamma)
    return (material * MATERIAL_UNIT).float()


def _image(kappa: float, gamma: float, white: tuple[float, float] = (0.0, 0.0), map_: Floats | None = None) -> Measured:
    """Under a map (None: a coloured sky). `white`: the least and the largest share of pixels held at white."""
    shading = Shading.of(placed(radiance=sky() if map_ is None else map_, size=TABLES))
    found = shading.errors({"material": of_one_lobe(kappa, gamma)})
    need(white[0] <= found.clipped <= white[1], f"{found.clipped:.0%} of the pixels are beyond white by the definition")
    shown = f"; {found.clipped:.0%} of the pixels looked at held at white" if white[1] else ""
    limit = SHARP if gamma >= 1e3 else shading.due
    return found.within(limit, f"largest error of a displayed value, against the definition in float64{shown}")


def _relative(shading: Shading, material: Tensor) -> Measured:
    """The image of a material that hardly reflects, relative to the brightest of it."""
    wanted, linear = shading.defined({"material": material})
    full = (shading.gbuffer.coverage.flatten()[shading.pixels] == 1).numpy()
    need(0 < linear.max() < 1e-4, "the definition is not dark here")
    worst = 0.0
    for renderer in (shading.renderer, shading.renderer.exact()):
        with torch.no_grad():
            image = renderer.render({"material": material[None]})[0].reshape(-1, 3)
        seen = image[shading.pixels].double().numpy()[full]
        worst = max(worst, float(abs(seen - wanted[full]).max() / wanted[full].max()))
    return Measured(worst, 2e-5, "error of a displayed value relative to the brightest, which is about 1e-5")


def _dark() -> Measured:
    return _relative(Shading.of(placed(radiance=sky())), of_one_lobe(1e-6, 1.0))


def _gradient(kappa: float, gamma: float) -> Measured:
    shading = Shading.of(placed(radiance=0.2 * sky(), size=TABLES))
    error = shading.gradient_error({"material": of_one_lobe(kappa, gamma)}, "material", 1e-3 * MATERIAL_UNIT)
    return Measured(error, GRADIENT, "relative error of the gradient, against differences of the definition")


def _red(material: str, groups: tuple[str, ...] | None = None) -> Shading:
    """A red ball of a preset under a coloured sky, compiled for attacks on `groups` (None: the default groups)."""
    return Shading.of(placed(radiance=0.5 * sky(), thing={"material": material, "color": (0.7, 0.05, 0.0)}), groups)


def _gloss(material: str) -> Measured:
    shading = _red(material)
    _, linear = shading.defined({})
    need(bool((linear[:, 2].max() > 0.01) == (material != "brushed-metal")), "blue light is reflected, or it is not")
    return shading.errors({}).within(shading.due, "largest error of a displayed value, against the definition")


def _gloss_gradient(group: str) -> Measured:
    step = {"material": 1e-3 * MATERIAL_UNIT, "illumination_rgb": 1e-2}[group]
    error = _red("glossy-paint", (group,)).gradient_error({}, group, step)
    return Measured(error, GRADIENT, "relative error of the gradient, against differences of the definition")


def _held(by: float) -> Measured:
    """A material moved far beyond its bounds is held there by the attack, and rendered.

    At the upper ones it is a mirror: white where it shows one of the sky's 128 texels, else nearly black. At the lower
    ones it reflects 3e-6 of the light: what is displayed is compared relative to the brightest, so that black fails.
    """
    shading = Shading.of(placed(radiance=sky(), size=TABLES))
    start = shading.renderer.initial()["material"]
    problem = linear_problem(shading.renderer, ("material",))
    material = start + problem.clamp({"material": torch.full_like(start, by)})["material"]
    kappa, gamma = (1e4, 1e5) if by > 0 else (1e-6, 1e-3)
    wanted = torch.tensor([log(kappa), log(gamma)], dtype=torch.float64)[:, None] * 30.0
    need(float((material.double() - wanted).abs().max()) < 1e-3, f"it is not held at κ = {kappa:g} and γ = {gamma:g}")
    found = shading.errors({"material": material})
    if by < 0:
        return _relative(shading, material)
    need(0 < found.clipped < 0.5, f"{found.clipped:.0%} of the pixels are beyond white by the definition")
    return found.within(SHARP, "largest error of a displayed value at the bounds, against the definition")


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "lobes", "the loop's image is within its tolerance, the exact image within rounding"
    return [
        Case(
            "κ 1e4, γ 1",
            family,
            "exp(1e4) overflows any float; one lit texel",
            "white where the texel shines, black beyond its horizon",
            lambda: _image(1e4, 1, (0.1, 0.9), np.roll(sun(1.0, 0.0), 8, axis=1)),
            "clipped",
        ),
        Case(
            "κ 1e4, γ 1e5",
            family,
            "a mirror: nothing, and 0.3° further white",
            same,
            lambda: _image(1e4, 1e5, (0.01, 0.5)),
            "clipped",
        ),
        Case("κ 0.5, γ 1e5", family, "a lobe of 0.3°, narrower than a texel", same, lambda: _image(0.5, 1e5)),
        Case(
            "κ 88, γ 1e3", family, "exp(88) is float32's largest", same, lambda: _image(88, 1e3, (0.1, 0.9)), "clipped"
        ),
        Case("κ 0.5, γ 300", family, "a glossy lobe, not clipped", same, lambda: _image(0.5, 300)),
        Case("κ 0.3, γ 1e-3", family, "γ → 0: a Lambertian body", same, lambda: _image(0.3, 1e-3)),
        Case("κ → 0", family, "exp(x) − 1 for x = 1e-6", "no digits are lost in the difference", _dark),
        Case(
            "gradient, κ 4, γ 300",
            family,
            "a steep lobe",
            "the gradient is that of the definition",
            lambda: _gradient(4, 300),
        ),
        Case(
            "gradient, κ 0.3, γ 1",
            family,
            "a flat lobe",
            "the gradient is that of the definition",
            lambda: _gradient(0.3, 1),
        ),
        *(
            Case(f"red {name}", family, "the body's colour has no blue", what, partial(_gloss, name))
            for name, what in (
                ("plastic", "the gloss has the light's colour"),
                ("glossy-paint", "the gloss has the light's colour"),
                ("brushed-metal", "all light has the metal's colour"),
            )
        ),
        *(
            Case(
                f"gradient by {group}, red paint",
                family,
                "two layers, one without colour",
                "the gradient is that of the definition",
                partial(_gloss_gradient, group),
            )
            for group in ("material", "illumination_rgb")
        ),
        *(
            Case(
                name,
                family,
                "a step of η = 1e3 and more",
                "held at its bounds, and rendered",
                partial(_held, by),
                "clipped",
            )
            for name, by in (("material + 1e6", 1e6), ("material − 1e6", -1e6))
        ),
    ]
