"""The same stiff light and lobes by every way that a plan may choose: tables, kept factors, sums; loose and tight."""

from functools import partial

import numpy as np
import torch

from services.accuracy.placing import TABLES, placed, sky, sun
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lobes import of_one_lobe
from services.accuracy.stability.shading import EXACT, GRADIENT, Shading
from services.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from services.rendering.protocol import Parameters
from services.scenes.mesh import Floats

SHARPEST = "brushed-metal"
"""The preset with the narrowest highlight."""

LOST = 1e-2
"""Share of a signed step's gain that a table may lose."""


def _compiled(radiance: Floats, group: str, tolerance: Tolerance = DEFAULT_TOLERANCE) -> Shading:
    return Shading.of(placed(radiance=radiance, size=TABLES, thing={"material": SHARPEST}), (group,), tolerance)


def _attacked(shading: Shading, group: str) -> Parameters:
    """Values far from the scene's own: normals turned by up to 0.5, a sun elsewhere, a mirror."""
    start = shading.renderer.initial()[group]
    if group == "normals":
        return {group: start + torch.rand(start.shape, generator=torch.Generator().manual_seed(3)) - 0.5}
    if group == "illumination":
        light = torch.full_like(start, 1e-3)
        light[start.shape[0] // 3, start.shape[1] // 8] = 1e4
        return {group: light}
    return {group: of_one_lobe(1e4, 1e5)}


def _image(radiance: Floats, group: str, moved: bool, tolerance: Tolerance = DEFAULT_TOLERANCE) -> Measured:
    shading = _compiled(radiance, group, tolerance)
    plan = shading.renderer.plan
    need(plan.groups == (group,), f"the plan is for {plan.groups}")
    found = shading.errors(_attacked(shading, group) if moved else {})
    need(found.exact <= EXACT, f"the exact image is off by {found.exact:.1e}")
    need(
        moved or found.loop <= plan.error + EXACT, f"an error of {found.loop:.1e} where the plan says {plan.error:.1e}"
    )
    limit = EXACT if tolerance == "exact" else tolerance
    return Measured(
        found.loop, limit, f"largest error of a displayed value; the plan says {plan.error:.0e} at the start"
    )


def _gradient(group: str) -> Measured:
    error = _compiled(0.3 * sky(), group).gradient_error({}, group, 1e-2)
    return Measured(error, GRADIENT, "relative error of the gradient, against differences of the definition")


def _signs() -> Measured:
    """Each texel of the map has an edge where it sets behind the horizon, and a smooth table rounds these off.

    So the table's gradient is a few per cent off where the image is right to its tolerance; FGSM goes by its signs.
    """
    scene = placed(radiance=0.3 * sky(), size=TABLES, thing={"material": "plastic"})
    loop, exact = (Shading.of(scene, ("normals",), tolerance) for tolerance in (DEFAULT_TOLERANCE, "exact"))
    need("table" in " ".join(stage.method for stage in loop.renderer.plan.stages), "there is no table to look at")
    covered = (exact.gbuffer.coverage > 0)[..., None].expand(-1, -1, 2)
    error = exact.gradient_error({}, "normals", 1e-5, covered)
    need(error <= EXACT, f"the exact gradient is off by {error:.1e} from differences of the definition")
    found, wanted = (shading.gradient({}, "normals")[0] for shading in (loop, exact))
    aligned = float(torch.cosine_similarity(found.flatten(), wanted.flatten(), dim=0))
    need(aligned > 0.99, f"the cosine of the gradient to the exact one is {aligned:.4f}")
    # A step by signs gains Σ|gradient| where all are right, and loses 2|gradient| for each that is wrong.
    lost = float(2 * wanted[found.sign() != wanted.sign()].abs().sum() / wanted.abs().sum())
    return Measured(lost, LOST, f"share of a signed step's gain lost to wrong signs; the cosine is {aligned:.4f}")


def _dark(radiance: Floats) -> Measured:
    """All light is taken away by the attack, and the kept factors have nothing to do."""
    shading = _compiled(radiance, "illumination")
    off = {"illumination": torch.zeros_like(shading.renderer.initial()["illumination"])}
    with torch.no_grad():
        image = shading.renderer.render({g: v[None] for g, v in off.items()})[0]
    gradient, _ = shading.gradient(off, "illumination")
    need(bool((gradient[np.asarray(radiance).sum(axis=2) > 0] != 0).any()), "light cannot come back")
    full = shading.gbuffer.coverage == 1
    return Measured(float(image[full].abs().max()), 0.0, "brightest displayed value of a covered pixel")


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "plans", "within the tolerance; at the start within the plan's estimate"
    gradient = "the gradient is that of the definition"
    strong = sun(1e6, 1.0)
    found = []
    for group in ("normals", "illumination", "material"):
        own, far = partial(_image, strong, group, False), partial(_image, strong, group, True)
        found.append(Case(f"{group} only, sun of 1e6", family, "one texel of 512 on metal", same, own))
        found.append(Case(f"{group} only, moved far", family, "what the plan was not made for", same, far))
    return [
        *found,
        Case("normals only, gradient", family, "128 edges under a smooth table", "the signs that FGSM goes by", _signs),
        Case("illumination only, gradient", family, "128 texels at once", gradient, lambda: _gradient("illumination")),
        Case("material only, gradient", family, "108 numbers at once", gradient, lambda: _gradient("material")),
        Case(
            "illumination only, off",
            family,
            "all light attacked away",
            "black, and can come back",
            lambda: _dark(sky()),
        ),
        *(
            Case(
                f"tolerance {tolerance}",
                family,
                "normals attacked, on metal",
                same,
                partial(_image, sky(), "normals", True, tolerance),
            )
            for tolerance in ("exact", 1e-6, 1e-5, 1e-2, 0.1)
        ),
    ]
