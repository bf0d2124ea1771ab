"""Environment maps in the torch renderer (suns, darkness, damage, one texel and eight million), and the same stiff
light and lobes by every way that a plan may choose: tables, kept factors, sums; loose and tight.
"""

from collections.abc import Iterator
from math import pi

import numpy as np
import torch

from scene_attack.rendering.factory import build
from scene_attack.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.table import look_up
from scene_attack.scenes.environment import average, from_image, radiance_of
from scene_attack.scenes.mesh import FIT_RADIUS, Doubles, Floats
from scene_attack_accuracy.placing import TABLES, broad_sun, placed, sky, sun
from scene_attack_accuracy.stability import references
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.references import of_sphere
from scene_attack_accuracy.stability.torch_shading import EXACT, SHARP, Shading, of_one_lobe

LAMBERTIAN = of_one_lobe(float(np.log1p(1 / pi)), 1e-3)
"""exp(κ) − 1 = 1/π, and γ = 1e-3 takes less than 1 % of it."""


def _image_under(map_: Floats, kappa: float = 0.3, gamma: float = 1.0, clipped: bool = False) -> Measured:
    shading = Shading.of(placed(radiance=map_, size=TABLES))
    errors = shading.errors({"material": of_one_lobe(kappa, gamma)})
    need(not clipped or errors.clipped > 0, "nothing is beyond white by the definition")
    return errors.within(SHARP if gamma >= 1e3 else shading.due)


def _dark_map() -> Measured:
    """No light at all: the object is black, and light can still be attacked."""
    shading = Shading.of(placed(radiance=np.zeros((8, 16, 3), np.float32)))
    with torch.no_grad():
        image = shading.renderer.render({})[0]
    full = shading.gbuffer.coverage == 1
    need(bool(full.any()), "no pixel is fully covered")
    light = shading.renderer.initial()["illumination"]
    need(bool((light == 0).all()), "a dark map has light")
    gradient, _ = shading.gradient({"illumination": light + 1e-3}, "illumination")
    need(largest(gradient) > 0, "light cannot be attacked")
    return Measured(largest(image[full]), 0.0, "brightest displayed value; black is 0")


def _constant() -> Measured:
    """A nearly Lambertian white sphere in even light is even: 0.9 wherever it is looked at (closed form)."""
    shading = Shading.of(placed(radiance=np.full((64, 128, 3), 3.0, np.float32)))
    with torch.no_grad():
        image = shading.renderer.render({"material": LAMBERTIAN[None]})[0]
    seen = image[shading.gbuffer.coverage == 1].double().numpy()
    reference = float(references.displayed(np.array([0.9]))[0])
    return Measured(largest(seen - reference), 0.01, "distance from the displayed value of 0.9, closed form")


def _scale(factor: float) -> Measured:
    """The exposure undoes a map's scale: the image is that of the definition, which has float64's range."""
    scaled = (sky().astype(np.float64) * factor).astype(np.float32)
    need(bool((scaled >= np.finfo(np.float32).tiny).all() and np.isfinite(scaled).all()), "float32 does not hold it")
    shading = Shading.of(placed(radiance=scaled))
    errors = shading.errors({})
    need(errors.clipped == 0, "it is beyond white")
    return errors.within(shading.due)


def _from_file(row: int, column: int) -> Measured:
    """One lit pixel of a file lights a white sphere from where it stands: 0.9 max(0, n·ω), whatever its radiance.

    The middle of an equirectangular image is +x and the view turns towards +z to the right, so the pixel's azimuth is
    2π (¾ − u) from +z towards +x, and its polar angle runs from the top. Normals are those of a sphere.
    """
    image = np.zeros((16, 32, 3), np.float32)
    image[row, column] = 7.0
    theta, phi = (row + 0.5) * pi / 16, 2 * pi * (0.75 - (column + 0.5) / 32)
    light = np.array([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)])
    scene = placed(radiance=average(radiance_of(image), 16, 32), size=(32, 32), camera={"azimuth": -0.4})
    normals, full = of_sphere(scene, FIT_RADIUS)
    reference = references.displayed(0.9 * np.maximum(normals @ light, 0.0))
    need(0.2 < float((reference > 0).mean()) < 1 and float(reference.max()) > 0.5, "too little is lit, or all")
    renderer = build(scene, "torch")
    worst = 0.0
    for variant in (renderer, renderer.exact()):
        with torch.no_grad():
            shown = variant.render({"material": LAMBERTIAN[None]})[0].reshape(-1, 3)[full].double().numpy()
        worst = max(worst, float(np.abs(shown - reference[:, None])[reference > 0.1].max()))
        need(float(shown[reference == 0].max()) < 0.1, "what faces away is lit")
    # γ = 1e-3 takes up to 1 % of the radiance, which is half of that on display; and a pixel's normals are averaged.
    return Measured(worst, 5e-3, "largest error of a displayed value where it is above 0.1, closed form")


def _cleaned(texel: float) -> Measured:
    """A damaged texel of a file becomes 0, and no other texel changes."""
    image = sky(16, 32)
    image[3, 5] = texel
    clean = radiance_of(image)
    need(bool(np.isfinite(clean).all()), "it has texels that are not finite")
    reference = image.copy()
    reference[3, 5] = 0
    need(bool((clean >= 0).all()), "it has negative texels")
    return Measured(largest(clean - from_image(reference)), 0.0, "change of any other texel; this one is 0")


def _large(height: int, width: int) -> Measured:
    """A large map with a sun of 1e6 in one texel, averaged down to 16×32."""
    random = np.random.default_rng(3)
    large = random.random((height, width, 3), dtype=np.float32)
    large[height // 3, width // 5] = 1e6
    seen = average(large, 16, 32).astype(np.float64)
    need(bool(np.isfinite(seen).all()), "a texel is not finite")
    error = np.abs(seen - _block_means(large, 16, 32)) / seen
    return Measured(float(error.max()), 1e-6, "relative error of a texel, against means by solid angle")


def _block_means(large: Floats, rows: int, cols: int) -> Doubles:
    """Means over whole blocks, rows weighted by solid angle. The sizes must divide."""
    height, width = large.shape[0] // rows, large.shape[1] // cols
    weight = np.sin((np.arange(large.shape[0]) + 0.5) * pi / large.shape[0])
    out = np.empty((rows, cols, 3))
    for i in range(rows):
        band, w = large[i * height : (i + 1) * height].astype(np.float64), weight[i * height : (i + 1) * height]
        for j in range(cols):
            out[i, j] = w @ band[:, j * width : (j + 1) * width].mean(axis=1) / w.sum()
    return out


def _one_texel_spread() -> Measured:
    """A map of one texel is the same from everywhere, at any size and turn."""
    spread = average(np.full((1, 1, 3), 0.7, np.float32), 64, 128, 1.234)
    return Measured(largest(spread - np.float32(0.7)), 1e-7, "distance from the one texel's radiance")


def _turned(steps: int, exact: bool = True) -> Measured:
    """A map on another grid and turned, against means over a fine grid that divides both, written as loops.

    The turn is `steps` columns of the fine grid's 224; with `exact` False another 1e-9 radians, which move a billionth
    of the light.
    """
    source = sky(16, 32)
    fine = np.roll(source.astype(np.float64).repeat(5, axis=0).repeat(7, axis=1), steps, axis=1)
    edges = np.cos(np.linspace(0, pi, 81))
    weight = edges[:-1] - edges[1:]
    worst = 0.0
    seen = average(source, 5, 7, steps * 2 * pi / 224 + (0.0 if exact else 1e-9))
    for i in range(5):
        rows = slice(16 * i, 16 * i + 16)
        for j in range(7):
            mean = weight[rows] @ fine[rows, 32 * j : 32 * j + 32].mean(axis=1) / weight[rows].sum()
            worst = max(worst, largest(seen[i, j] / mean - 1))
    return Measured(worst, 1e-6, "relative error of a texel, against means over a grid of 80×224 written as loops")


def _one_texel() -> Measured:
    """A map of one texel is one direction, −z, for the renderer: the shading that is defined so."""
    shading = Shading.of(placed(radiance=np.ones((1, 1, 3), np.float32), camera={"azimuth": 2.0}))
    errors = shading.errors({"material": of_one_lobe(0.3, 1.0)})
    return errors.within(shading.due)


def _opposite() -> Measured:
    """All light from straight behind the object, and normals turned to it: the half vector has no direction."""
    scene = placed(radiance=np.ones((1, 1, 3), np.float32), camera={"azimuth": 0.0, "elevation": 0.0})
    shading = Shading.of(scene)
    need(bool(np.allclose(references.texels(1, 1)[0][0], -scene.view[:3, 2])), "the light is not opposite the viewer")
    turned = torch.tensor([pi - 0.1, pi / 2 + 0.1]).expand(*shading.renderer.size, 2).contiguous()
    parameters = {"material": of_one_lobe(0.02, 0.01), "normals": turned}
    errors = shading.errors(parameters)
    gradient, _ = shading.gradient(parameters, "normals")
    need(largest(gradient) > 0, "no normal has a gradient")
    return errors.within(shading.due)


def environment_cases() -> Iterator[Case]:
    """The cases of this family."""
    same = "the loop's image is within its tolerance, the exact image within rounding"
    inf, nan, refused = float("inf"), float("nan"), "a clear error names the map"
    means = "means by solid angle"
    yield case("sun of 1e6 in a sky of 1", "one texel of 512", same, _image_under, sun(1e6, 1))
    yield case("sun of 1e6 in darkness", "one lit texel", same, _image_under, sun(1e6, 0))
    mirror = "κ 100, γ 1e4 under one texel"
    yield case("sun of 1e6 on a mirror", mirror, same, _image_under, sun(1e6, 0), 100, 1e4, True, held="clipped")
    yield case("a smaller sun of 1e6", "a 32×64 map, one texel of 1e6", same, _image_under, sun(1e6, 1, 32, 64), 1, 50)
    yield case("all-zero map", "no light, no scale", "black, finite, still attackable", _dark_map)
    yield case("constant map", "no contrast", "an even image of 0.9", _constant)
    yield case("map × 1e30", "squares beyond float32", "the scale is undone", _scale, 1e30)
    yield case("map × 1e-36", "squares below float32", "the scale is undone", _scale, 1e-36)
    pixel, there = "a file with one lit pixel of 512", "the sphere is lit from there"
    for row, column in ((2, 15), (5, 2), (8, 31), (12, 30)):
        yield case(f"pixel {column} of row {row} lit", pixel, there, _from_file, row, column)
    yield case("1×1 map", "one direction", same, _one_texel)
    yield case("light opposite the viewer", "a half vector without direction", same, _opposite)
    yield case("+inf texel", "light without end", refused, _cleaned, inf, refusal="environment")
    yield case("−inf texel", "less than nothing", refused, _cleaned, -inf, refusal="environment")
    yield case("NaN texel", "not a number", refused, _cleaned, nan, refusal="environment")
    yield case("negative texel", "ringing of a filter", "held at 0, all else stays", _cleaned, -3.0, held="clipped")
    yield case("1×1 source", "one texel for 8,192", "the same from everywhere", _one_texel_spread)
    yield case("512×256 source", "256 texels for one, a sun in one", means, _large, 256, 512)
    yield case("4096×2048 source", "16,384 texels for one, a sun in one", means, _large, 2048, 4096, slow=True)
    yield case("map turned by 2π", "a whole turn", means, _turned, 224)
    yield case("map turned by 0.7", "25 of 224 parts of a turn", means, _turned, 25)
    yield case("map turned by 1e-9", "a sliver of every texel", means, _turned, 0, False)


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


def _planned_image(group: str, moved: bool, tolerance: Tolerance = DEFAULT_TOLERANCE) -> Measured:
    # A plan sums a strong texel beside its table, so that light which the table holds has to be broad.
    radiance = broad_sun() if group in ("normals", "material") else sun(1e6, 1.0)
    shading = _compiled(radiance, group, tolerance)
    plan = shading.renderer.plan
    need(plan.groups == (group,), f"the plan is for {plan.groups}")
    errors = shading.errors(_attacked(shading, group) if moved else {})
    need(errors.exact <= EXACT, f"the exact image is off by {errors.exact:.1e}")
    stated = f"the plan says {plan.error:.1e}"
    need(moved or errors.loop <= plan.error + EXACT, f"an error of {errors.loop:.1e} where {stated}")
    limit = EXACT if tolerance == "exact" else tolerance
    return Measured(errors.loop, limit, f"largest error of a displayed value; {stated} at the start")


def _gradient(group: str) -> Measured:
    return _compiled(0.3 * sky(), group).differentiated({}, group, 1e-2)


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
        reference = np.stack([value * (along @ a), value * (down @ a)], axis=1)
        errors.append(
            (np.abs(seen.detach().numpy() - value[:, None]).max(), np.abs(gradient.numpy() - reference).max())
        )
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
    gradient, reference = (shading.gradient({}, "normals")[0] for shading in (loop, exact))
    aligned = float(torch.cosine_similarity(gradient.flatten(), reference.flatten(), dim=0))
    need(aligned > 0.99, f"the cosine of the gradient to the exact one is {aligned:.4f}")
    # A step by signs gains Σ|gradient| where all are right, and loses 2|gradient| for each that is wrong.
    lost = float(2 * reference[gradient.sign() != reference.sign()].abs().sum() / reference.abs().sum())
    return Measured(lost, LOST, f"share of a signed step's gain lost to wrong signs; the cosine is {aligned:.4f}")


def _darkened() -> Measured:
    """All light is taken away by the attack, and the kept factors have nothing to do."""
    shading = _compiled(sky(), "illumination")
    off = {"illumination": torch.zeros_like(shading.renderer.initial()["illumination"])}
    with torch.no_grad():
        image = shading.renderer.render({g: v[None] for g, v in off.items()})[0]
    gradient, _ = shading.gradient(off, "illumination")
    need(bool((gradient[sky().sum(axis=2) > 0] != 0).any()), "light cannot come back")
    full = shading.gbuffer.coverage == 1
    return Measured(largest(image[full]), 0.0, "brightest displayed value of a covered pixel")


def plan_cases() -> Iterator[Case]:
    """The cases of this family."""
    same = "within the tolerance; at the start within the plan's estimate"
    gradient = "the gradient is that of the definition"
    broad, texel = "a hundred bright texels, in the table", "one texel of 512 on metal"
    for group, light, what in (
        ("normals", "broad sun", broad),
        ("illumination", "sun of 1e6", texel),
        ("illumination_rgb", "sun of 1e6", texel),
        ("material", "broad sun", broad),
    ):
        yield case(f"{group} only, {light}", what, same, _planned_image, group, False)
        yield case(f"{group} only, moved far", "what the plan was not made for", same, _planned_image, group, True)
    yield case("table of a known function", "cells of 3°, poles", "third order, by its closed form", _look_up)
    yield case("normals only, gradient", "128 edges under a smooth table", "the signs that FGSM goes by", _signs)
    for group, count in (
        ("illumination", "128 texels"),
        ("illumination_rgb", "384 values"),
        ("material", "108 numbers"),
    ):
        yield case(f"{group} only, gradient", f"{count} at once", gradient, _gradient, group)
    yield case("illumination only, off", "all light attacked away", "black, and can come back", _darkened)
    for tolerance in ("exact", 1e-6, 1e-5, 1e-2, 0.1):
        what = "normals attacked, on metal"
        yield case(f"tolerance {tolerance}", what, same, _planned_image, "normals", True, tolerance)
