"""The same stiff light and lobes by every way that a plan may choose: tables, kept factors, sums; loose and tight."""

from functools import partial
from math import pi

import numpy as np
import torch

from services.accuracy.placing import TABLES, broad_sun, placed, sky, sun
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lobes import of_one_lobe
from services.accuracy.stability.shading import EXACT, GRADIENT, Shading
from services.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from services.rendering.protocol import Parameters
from services.rendering.torch_renderer.table import look_up
from services.scenes.mesh import Doubles, Floats

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
    if group == "illumination_rgb":  # each channel has a sun of its own
        light = torch.full_like(start, -1e3).maximum(-shading.renderer.initial()["illumination"][..., None])
        for channel in range(3):
            light[start.shape[0] // 3, start.shape[1] // 8 + channel, channel] = 1e3 * (1 + channel)
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


def _look_up() -> Measured:
    """Tables of a known smooth function at their nodes, exp(n·a), looked up all over the sphere, poles included.

    Splines through four nodes whose slopes are central differences are of third order: values, and of second in their
    derivatives. Nodes are computed here, not taken from the renderer.
    """
    a = np.array([0.5, -0.6, 0.62])
    random = torch.rand(4000, 2, generator=torch.Generator().manual_seed(12), dtype=torch.float64)
    angles = ((random - torch.tensor([0.5, 0.0])) * torch.tensor([2 * pi, pi], dtype=torch.float64)).requires_grad_()
    azimuth, polar = angles.detach().numpy().T
    errors = []
    for rows in (32, 64):
        middle = (np.arange(2 * rows) + 0.5) * pi / rows
        down, around = np.meshgrid(middle[:rows], middle - pi, indexing="ij")
        table = np.exp(_unit(around.ravel(), down.ravel()) @ a)
        seen = look_up(torch.from_numpy(table)[:, None].repeat(1, 3), angles)
        (gradient,) = torch.autograd.grad(seen[:, 0].sum(), angles)
        value = np.exp(_unit(azimuth, polar) @ a)
        along = np.stack([np.sin(polar) * np.cos(azimuth), 0 * polar, -np.sin(polar) * np.sin(azimuth)], axis=1)
        down = np.stack([np.cos(polar) * np.sin(azimuth), -np.sin(polar), np.cos(polar) * np.cos(azimuth)], axis=1)
        wanted = np.stack([value * (along @ a), value * (down @ a)], axis=1)
        errors.append((np.abs(seen.detach().numpy() - value[:, None]).max(), np.abs(gradient.numpy() - wanted).max()))
    orders = np.log2(np.array(errors[0]) / errors[1])
    need(orders[0] > 2.7 and orders[1] > 1.7, f"the orders are {orders[0]:.1f} and {orders[1]:.1f}")
    # h³ and h² of h = π / 64, with third derivatives of up to 3.
    need(errors[1][1] < 3e-3, f"its derivatives are off by {errors[1][1]:.1e}")
    return Measured(
        float(errors[1][0]), 1e-4, f"largest error of a value; observed orders {orders[0]:.1f}, {orders[1]:.1f}"
    )


def _unit(azimuth: Doubles, polar: Doubles) -> Doubles:
    """Unit vectors [N, 3] of these angles in the camera's frame."""
    return np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], axis=1)


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
    found = []
    for group, word, map_, what in (
        # A plan sums a strong texel beside its table, so that light which the table holds has to be broad.
        ("normals", "broad sun", broad_sun(), "a hundred bright texels, in the table"),
        ("illumination", "sun of 1e6", sun(1e6, 1.0), "one texel of 512 on metal"),
        ("illumination_rgb", "sun of 1e6", sun(1e6, 1.0), "one texel of 512 on metal"),
        ("material", "broad sun", broad_sun(), "a hundred bright texels, in the table"),
    ):
        own, far = partial(_image, map_, group, False), partial(_image, map_, group, True)
        found.append(Case(f"{group} only, {word}", family, what, same, own))
        found.append(Case(f"{group} only, moved far", family, "what the plan was not made for", same, far))
    return [
        *found,
        Case("table of a known function", family, "cells of 3°, poles", "third order, by its closed form", _look_up),
        Case("normals only, gradient", family, "128 edges under a smooth table", "the signs that FGSM goes by", _signs),
        *(
            Case(f"{group} only, gradient", family, what, gradient, partial(_gradient, group))
            for group, what in (
                ("illumination", "128 texels at once"),
                ("illumination_rgb", "384 values at once"),
                ("material", "108 numbers at once"),
            )
        ),
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
                partial(_image, broad_sun(), "normals", True, tolerance),
            )
            for tolerance in ("exact", 1e-6, 1e-5, 1e-2, 0.1)
        ),
    ]
