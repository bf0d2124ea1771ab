"""Sharp, flat and dark lobes of the material."""

from math import log

import torch
from torch import Tensor

from services.accuracy.placing import TABLES, placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.shading import EXACT, LOOP, SLOPE, Shading
from services.rendering.torch_renderer.dsbrdf import LOG_GAMMA_RANGE, LOG_KAPPA_RANGE, SHAPE
from services.rendering.torch_renderer.units import MATERIAL_UNIT


def of_one_lobe(kappa: float, gamma: float) -> Tensor:
    """Material group [1, 3, 3, 2, 6] of one lobe with these values at all θ_d; the other two are dark."""
    material = torch.empty(1, *SHAPE, dtype=torch.float64)
    material[..., 0, :], material[..., 1, :] = LOG_KAPPA_RANGE[0], 0.0
    material[:, :, 0, 0], material[:, :, 0, 1] = log(kappa), log(gamma)
    return (material * MATERIAL_UNIT).float()


def _picture(kappa: float, gamma: float, clipped: bool) -> Measured:
    found = Shading.of(placed(radiance=sky(), size=TABLES)).errors({"material": of_one_lobe(kappa, gamma)})
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    need(clipped == (found.clipped > 0), f"{found.clipped:.0%} of the pixels are beyond white by the definition")
    shown = f"; {found.clipped:.0%} of the pixels looked at held at white" if clipped else ""
    return Measured(found.loop, LOOP, f"largest error of a displayed value, against the definition in float64{shown}")


def _dark() -> Measured:
    shading = Shading.of(placed(radiance=sky()))
    parameters = {"material": of_one_lobe(1e-6, 1.0)}
    wanted, linear = shading.defined(parameters)
    full = (shading.gbuffer.coverage.flatten()[shading.pixels] == 1).numpy()
    need(0 < linear.max() < 1e-4, "the definition is not dark here")
    with torch.no_grad():
        picture = shading.renderer.render({g: v[None] for g, v in parameters.items()})[0].reshape(-1, 3)
    seen = picture[shading.pixels].double().numpy()[full]
    error = float(abs(seen - wanted[full]).max() / wanted[full].max())
    return Measured(error, 1e-3, "error of the displayed value relative to the brightest, where it is about 1e-5")


def _slope(kappa: float, gamma: float) -> Measured:
    shading = Shading.of(placed(radiance=0.2 * sky(), size=TABLES))
    error = shading.slope_error({"material": of_one_lobe(kappa, gamma)}, "material", 1e-3 * MATERIAL_UNIT)
    return Measured(error, SLOPE, "relative error of the gradient, against differences of the definition")


def _held() -> Measured:
    """A material far beyond its bounds is pulled back to them, and rendered."""
    shading = Shading.of(placed(radiance=sky(), size=TABLES))
    low, high = shading.renderer.bounds()["material"]
    start = shading.renderer.initial()["material"]
    material = torch.minimum(torch.maximum(start + 1e6, low.float()), high.float())
    need(bool((material[..., 0, :] == high[0].float()).all()), "κ is not held at its bound")
    wanted = torch.tensor([LOG_KAPPA_RANGE[1], LOG_GAMMA_RANGE[1]], dtype=torch.float64) * MATERIAL_UNIT
    need(torch.allclose(material[0, 0, 0, :, 0].double(), wanted), "the bounds are not κ = 1e4 and γ = 1e5")
    found = shading.errors({"material": material})
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    return Measured(found.loop, LOOP, "largest error of a displayed value at the bounds, against the definition")


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "lobes", "the loop's picture has the tolerance, the judge's is exact"
    return [
        Case("κ 1e4, γ 1", family, "exp(1e4) overflows any float", same, lambda: _picture(1e4, 1, True), "clipped"),
        Case(
            "κ 1e4, γ 1e5",
            family,
            "a mirror: nothing, and 0.3° further white",
            same,
            lambda: _picture(1e4, 1e5, True),
            "clipped",
        ),
        Case("κ 0.5, γ 1e5", family, "a lobe of 0.3°, narrower than a texel", same, lambda: _picture(0.5, 1e5, False)),
        Case("κ 88, γ 1e3", family, "exp(88) is float32's largest", same, lambda: _picture(88, 1e3, True), "clipped"),
        Case("κ 0.5, γ 300", family, "a glossy lobe, not clipped", same, lambda: _picture(0.5, 300, False)),
        Case("κ 0.3, γ 1e-3", family, "γ → 0: a Lambertian body", same, lambda: _picture(0.3, 1e-3, False)),
        Case("κ → 0", family, "exp(x) − 1 for x = 1e-6", "no digits are lost in the difference", _dark),
        Case(
            "slope, κ 4, γ 300",
            family,
            "a steep lobe",
            "the gradient is that of the definition",
            lambda: _slope(4, 300),
        ),
        Case(
            "slope, κ 0.3, γ 1", family, "a flat lobe", "the gradient is that of the definition", lambda: _slope(0.3, 1)
        ),
        Case(
            "material + 1e6", family, "a step of η = 1e3 and more", "held at its bounds, and rendered", _held, "clipped"
        ),
    ]
