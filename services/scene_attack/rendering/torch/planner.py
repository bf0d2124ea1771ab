"""Plans the torch renderer: chooses, for each object and a set of attacked groups, the cheapest method to shade it,
states its error, and describes it as stages.

Every error is a difference of displayed values in [0,1], the largest over pixels and channels: by bounds where they
exist, else measured. Errors of tables are measured, not derived: at the object's own pixels, for the scene's own values
and for random perturbations of the attacked groups, against the direct sum. A table is ruled out beforehand if it has a
highlight narrower than its mesh, which the measurement may miss. During the attack a sample of pixels is checked in
every image (`table.chosen_pixels`), and the plan states the error that this check enforces. The error of gradients is
measured against the exact float64 sum.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import log, pi

import torch
from torch import Tensor

from scene_attack.rendering.color import to_display
from scene_attack.rendering.kernels import compiled, levels
from scene_attack.rendering.plan import GradientError, Item, Plan, Stage, Tolerance
from scene_attack.rendering.torch import dsbrdf
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN
from scene_attack.rendering.torch.light import LIGHT_GROUPS, attacks_light
from scene_attack.rendering.torch.shader import Method, Recipe, Shader, Sky, Surface, checked_pixels, displayed_error
from scene_attack.rendering.torch.shading import albedo
from scene_attack.rendering.torch.surfaces import IN_SHADOW, WHOLE
from scene_attack.rendering.torch.table import tiles, to_vectors, touched

MAX_PIXELS_MOVING_NORMALS = 4_096
MAX_PIXELS_FIXED_NORMALS = 16_384
"""Maximum number of pixels at which a table is measured, where normals are attacked and where they are not. The pixels
are evenly spaced among the object's pixels, ordered by their normals."""
N_NORMALS = 16_384
"""Number of normals at which a table is measured where normals are attacked: those of the sampled pixels and randomly
perturbed copies of them."""
MAX_COPIES = 8
"""Maximum number of perturbed copies of each sampled pixel."""
FIRST_STRIDE = 16
"""Stride through the pixels of a first, coarse measurement: most tables already fail there."""
MAX_PIXELS_FLOAT64 = 1_024
"""Maximum number of pixels at which float32 is measured against float64."""
MAX_DISPLAY_DERIVATIVE = 12.92
"""Derivative of the sRGB curve at black: the largest factor by which the curve magnifies a linear error."""
MAX_PERTURBATION = {"normals": 0.3, "material": 3.6} | dict.fromkeys(LIGHT_GROUPS, 0.36 * ILLUMINATION_MEAN)
"""Largest random perturbation of a coordinate, by group: that of normals in a typical successful attack, those of
light and material in 120 steps of the paper's size."""
N_PERTURBATIONS = 2
"""Number of random perturbations of light and material at which a table is measured, besides the scene's own values."""
MAX_LIGHT_GAIN = 10.0
"""Factor by which light may grow where it is attacked: a lobe is left out only if it is negligible under the light plus
its mean, times this factor."""


@dataclass(frozen=True)
class LobeBounds:
    """Error bounds [3, lobes] by channel and lobe.

    dark: the error of leaving the lobe out. straight: the error of replacing it by a straight line in log n·h.
    """

    dark: Tensor
    straight: Tensor


def lobe_bounds(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], kept: Tensor) -> LobeBounds:
    """Bounds the errors of simplifying lobes, over all normals that a pixel may have.

    `illumination` [D of the whole map]; `kept` holds the indices of the texels that are used.
    """
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves[kept])
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    if attacks_light(groups):  # the attack may light a black texel
        illumination = MAX_LIGHT_GAIN * (illumination + ILLUMINATION_MEAN)
    light = _brightest(surface, sky, illumination, kept)
    # The remainder of the line is half its second derivative times (γ log n·h)², under the cosine n·ω. A seen normal
    # has n·h ≥ n·ω / 2, and t (log t/2)² is at most 1.09; a normal that moves may be anywhere.
    furthest = log(dsbrdf.COSINE_FLOOR) ** 2 if "normals" in groups else 1.09
    curved = 0.5 * exponent * exponent.exp() * (1 + exponent) * gamma.square() * furthest
    return LobeBounds(
        MAX_DISPLAY_DERIVATIVE * (torch.expm1(exponent) * light).sum(-1),
        MAX_DISPLAY_DERIVATIVE * (curved * light).sum(-1),
    )


def roughness(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], rows: int) -> Tensor:
    """Scores how badly a table of `rows` rows interpolates each texel's light, [D of the whole map].

    The score orders texels; it is not an error. It has two terms. Where a light sets behind the horizon, radiance has
    a kink of slope light · ρ, which Catmull-Rom interpolation rounds off by about 0.07 of the mesh width; there n·h is
    at most sin θ_d. And a lobe as narrow as the mesh (ρ falls from its peak by the fraction max(1, κ) γ θ² / 2) is
    missed; wider lobes lose less.
    """
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves)
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    light = sky.power * _brightest_texels(illumination, groups)
    cosine = (sky.directions.half[:3] * sky.directions.towards).sum(0).clamp(0.0, 1.0)
    sine = (1 - cosine.square()).clamp_min(1e-8).sqrt()
    mesh = pi / rows
    at_horizon = dsbrdf.reflectance(sine.log(), log_kappa, gamma).sum(1)
    narrow = (mesh**2 * exponent.clamp_min(1.0) * gamma).clamp_max(1.0) ** 1.5
    peak = (torch.expm1(exponent) * narrow).sum(1) * cosine
    return ((0.07 * mesh * at_horizon + 0.05 * peak) * light).amax(0)


def too_narrow(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe, left: float
) -> bool:
    """Returns whether the recipe's table contains a visible highlight that is narrower than its mesh.

    Visible means brighter than a tenth of `left`, the tolerance that remains. The sampled pixels may all miss such a
    highlight, so a measured error would be too small.
    """
    assert recipe.rows is not None
    held = recipe.active_texels[
        ~torch.isin(recipe.active_texels, recipe.per_pixel_texels.to(recipe.active_texels.device))
    ]
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves[held])
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    light = _brightest(surface, sky, _brightest_texels(illumination, groups), held)
    seen = (MAX_DISPLAY_DERIVATIVE * torch.expm1(exponent) * light > left / 10) & recipe.varying[..., None]
    return bool((exponent.clamp_min(1.0) * gamma * seen * (pi / recipe.rows) ** 2 > 1).any())


def float32_error(surface: Surface, sky: Sky, illumination: Tensor, recipe: Recipe) -> float:
    """Estimates the error of the sum in float32: four times the error measured against float64.

    It is largest in narrow highlights. Attacked normals may turn in any direction, so the measurement then adds an
    equal number of random normals.
    """
    sample = subset(surface, MAX_PIXELS_FLOAT64)
    if recipe.moving:
        random = torch.Generator().manual_seed(1)
        anywhere = torch.rand(sample.angles.shape, generator=random, dtype=torch.float64)
        anywhere = (anywhere * torch.tensor([2 * pi, pi]) - torch.tensor([pi, 0.0])).to(sample.angles.device)
        sample = _turned(sample, torch.cat([sample.angles, anywhere]))
    values = [
        Shader(replace(recipe, method="summed", rows=None, moving=True, dtype=dtype), sky, sample, illumination)(
            sample.angles, illumination, sample.material
        )
        for dtype in (torch.float32, torch.float64)
    ]
    return 4 * displayed_error(values[0], values[1], sample.base_color)


class MeasuredErrors:
    """Measures errors of tables at a surface's pixels, for the scene's own values and random perturbations of them."""

    def __init__(self, surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe) -> None:
        random = torch.Generator().manual_seed(0)
        moving = "normals" in groups
        self._surface = spread(
            subset(surface, MAX_PIXELS_MOVING_NORMALS if moving else MAX_PIXELS_FIXED_NORMALS), moving, random
        )
        self._sky, self._illumination = sky, illumination
        self._perturbed = [(illumination, surface.material)]
        for _ in range(N_PERTURBATIONS if attacks_light(groups) or "material" in groups else 0):
            light, material = illumination, surface.material
            if "illumination" in groups:
                light = (light + MAX_PERTURBATION["illumination"] * _signs(light, random)).clamp_min(0.0)
            if "illumination_rgb" in groups:
                light = light.expand(3, -1)
                light = (light + MAX_PERTURBATION["illumination_rgb"] * _signs(light, random)).clamp_min(0.0)
            if "material" in groups:
                material = material + MAX_PERTURBATION["material"] * _signs(material, random)
            self._perturbed.append((light, material))
        self.angles = self._surface.angles
        """The normals at which errors are measured: azimuth and polar angle [N, 2], radians."""
        self._truth = list(self._values(recipe))

    def error(self, recipe: Recipe, limit: float) -> float:
        """Returns the largest error of `recipe`'s table, or the first error found that exceeds `limit`."""
        largest = 0.0
        for stride in (FIRST_STRIDE, 1):
            color = self._surface.base_color[::stride]
            for value, truth in zip(self._values(recipe, stride), self._truth, strict=True):
                largest = max(largest, displayed_error(value, truth[::stride], color))
                if largest > limit:
                    return largest
        return largest

    @torch.no_grad()
    def _values(self, recipe: Recipe, stride: int = 1) -> Iterator[Tensor]:
        """Yields the radiance [P, 3] of each perturbation at every `stride`-th pixel."""
        plain = replace(recipe, method="summed", moving=True, guard=None)
        sample = _every(self._surface, stride)
        shader = Shader(plain, self._sky, sample, self._illumination)
        for light, material in self._perturbed:
            yield shader(sample.angles, light, material)


def spread(surface: Surface, moving: bool, random: torch.Generator) -> Surface:
    """Returns the surface with its own normals and, if `moving`, randomly perturbed copies of them."""
    if not moving:
        return surface
    copies = max(2, min(MAX_COPIES, N_NORMALS // len(surface.angles)))
    return _turned(surface, torch.cat([surface.angles, *(_perturbed(surface.angles, random) for _ in range(copies))]))


def _perturbed(angles: Tensor, random: torch.Generator) -> Tensor:
    """Returns angles [P, 2], each moved at random by at most what attacks move it."""
    step = 2 * torch.rand(angles.shape, generator=random, dtype=torch.float64).to(angles.device) - 1
    return angles + MAX_PERTURBATION["normals"] * step


def _turned(surface: Surface, angles: Tensor) -> Surface:
    """Returns the surface with other normals, `angles` [n · P, 2] for n copies of its pixels."""
    n = len(angles) // len(surface.angles)
    return replace(
        surface,
        angles=angles,
        base_color=surface.base_color.repeat(n, 1),
        viewers=None if surface.viewers is None else surface.viewers.repeat(n, 1),
        visibility=None if surface.visibility is None else surface.visibility.repeat(1, n),
    )


def _signs(like: Tensor, random: torch.Generator) -> Tensor:
    return (torch.rand(like.shape, generator=random, dtype=torch.float64) - 0.5).sign().to(like.device)


def subset(surface: Surface, max_pixels: int) -> Surface:
    """Returns the surface at no more than `max_pixels` of its pixels, evenly spaced."""
    return _every(surface, stride(len(surface.angles), max_pixels))


def stride(n_pixels: int, max_pixels: int) -> int:
    """Returns the stride through pixels that leaves no more than `max_pixels` of them, at least 1."""
    return max(1, -(-n_pixels // max_pixels))


def _every(surface: Surface, stride: int) -> Surface:
    """Returns the surface at every `stride`-th of its pixels."""
    viewers = None if surface.viewers is None else surface.viewers[::stride]
    seen = None if surface.visibility is None else surface.visibility[:, ::stride]
    angles, color = surface.angles[::stride], surface.base_color[::stride]
    return replace(surface, angles=angles, base_color=color, viewers=viewers, visibility=seen)


def _brightest_texels(illumination: Tensor, groups: Sequence[str]) -> Tensor:
    """Returns the largest intensity that the random perturbations give each texel."""
    return illumination + sum(MAX_PERTURBATION[group] for group in LIGHT_GROUPS if group in groups)


def _brightest(surface: Surface, sky: Sky, illumination: Tensor, kept: Tensor) -> Tensor:
    """Returns the light [3, 1, D] of the kept directions times the surface's lightest base colour."""
    return ((sky.power * illumination)[:, kept] * surface.base_color.amax(0)[:, None])[:, None]


PAIRS = 2**18
"""Maximum number of pixels times directions whose gradient is measured: 512 pixels under a map of 16×32."""


@torch.enable_grad()
def gradient_errors(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe, exact: Recipe
) -> list[GradientError]:
    """Measures the error of each attacked group's gradient at a sample of a surface's pixels, in the order of `groups`:
    of those that are shaded, not of those that move surfaces.

    The gradient is that of a sum of the displayed values with normally distributed random weights. This is harsher than
    a network, whose weights are smooth: errors of neighbouring pixels do not cancel. The displayed values of a layer
    are those of the layer alone. The list is empty where nothing is attacked or no light reaches the surface.
    """
    random = torch.Generator().manual_seed(2)
    max_pixels = max(16, PAIRS // sky.power.shape[1])
    sample = subset(surface, max_pixels)
    if surface.viewers is None:
        sample = subset(spread(sample, "normals" in groups, random), max_pixels)
    weights = torch.randn(len(sample.angles), 3, generator=random, dtype=torch.float64).to(sample.angles.device)
    values = {"normals": sample.angles, "illumination": illumination, "material": sample.material}
    values["paint"] = sample.base_color
    if "illumination_rgb" in groups:
        values["illumination_rgb"] = illumination.new_zeros(3, len(illumination))
    groups = [group for group in groups if group in values]
    gradients = []
    for compared in (replace(recipe, guard=None), exact):
        leaves = {
            name: value.to(compared.dtype, copy=True).requires_grad_(name in groups) for name, value in values.items()
        }
        shader = Shader(compared, sky, sample, illumination)
        light = leaves["illumination"]
        if "illumination_rgb" in leaves:
            light = light + leaves["illumination_rgb"]
        radiance = shader(leaves["normals"], light, leaves["material"])
        displayed = to_display(radiance * leaves["paint"])
        total = (displayed * weights.to(compared.dtype)).sum()
        if not total.requires_grad:  # nothing shaded is attacked, or no light reaches the surface whatever is changed
            return []
        gradients.append(torch.autograd.grad(total, [leaves[name] for name in groups], materialize_grads=True))
    return [
        GradientError(part=surface.with_layer(surface.name), group=group, **_compared(value.double(), truth))
        for group, value, truth in zip(groups, *gradients, strict=True)
    ]


def _compared(value: Tensor, truth: Tensor) -> dict[str, float]:
    """Returns the relative L2 error, and the share of wrong signs among the coordinates whose gradient is not zero."""
    length = float(truth.norm())
    if length == 0.0:
        return {"relative": 0.0, "wrong_signs": 0.0}
    there = truth != 0
    wrong = (value.sign() != truth.sign()) & there
    return {
        "relative": float((value - truth).norm()) / length,
        "wrong_signs": float(wrong.sum()) / float(there.sum()),
    }


HEADROOM = 4.0
"""Assumed ratio of the largest error over all pixels to the largest error over the sampled pixels, both when a plan is
made and when an image is checked. In images of whole attacks the ratio was at most 2.6."""

METHOD_WORDS: dict[Method, str] = {
    "summed": "sum over directions and lobes",
    "precomputed_transport": "product of the light with factors computed once, as the image is linear in it",
    "cached_table": "sum over directions and lobes where a normal first needs it: neither light nor material changes",
}


def shadow_items(surfaces: Sequence[Surface]) -> Iterator[Item]:
    """Yields the plan's item on shadows, if some pixels are in shadow.

    Visibility is a fixed factor of the exact image, too, so leaving nothing out of it costs no error; that of its
    samples is in the work-precision report.
    """
    shadowed = {surface.name: surface.visibility for surface in surfaces if surface.visibility is not None}
    pixels = {surface.name: len(surface.angles) for surface in surfaces}
    if shadowed:
        hidden = sum(int((seen.amin(0) < WHOLE).sum()) for seen in shadowed.values())
        yield Item(
            what="pixels that see all of the light",
            kept=sum(pixels.values()) - hidden,
            of=sum(pixels.values()),
            why="from the others objects hide some of it: they are summed directly, by a visibility of each texel from "
            "each pixel that is found once",
        )


def radiance_stage(surface: Surface, recipe: Recipe, count: int, why: str, error: float) -> Stage:
    """Returns the stage that sums radiance at `count` normals, for the reason `why` and with the estimated `error`."""
    pairs = count * (len(recipe.active_texels) - len(recipe.per_pixel_texels)) * recipe.channels
    words = "sum over directions" if recipe.lambert and recipe.method == "summed" else METHOD_WORDS[recipe.method]
    kind = str(recipe.dtype).removeprefix("torch.")
    return Stage(
        part=surface.name,
        name=surface.with_layer("radiance"),
        method=f"{words}, {kind}, at {count} normals",
        when="once" if recipe.method == "cached_table" else "every image",
        evaluations=pairs if recipe.method == "precomputed_transport" else pairs * max(recipe.lobes, 1),
        unit="products" if recipe.lambert or recipe.method == "precomputed_transport" else "lobe values",
        why=why,
        error=error,
    )


def table_stages(
    surface: Surface, recipe: Recipe, count: int, *, ratio: float, measured: float, error: float
) -> list[Stage]:
    """Returns the stages of a table of `count` nodes, which takes `ratio` times less work than the direct sum.

    `measured` is the largest error found when the plan was made; `error` is the estimate that the sampled check
    enforces.
    """
    pixels = len(surface.angles)
    per_direction = recipe.channels * max(recipe.lobes, 1)
    stages = [radiance_stage(surface, recipe, count, "the normals that pixels are looked up between", 0.0)]
    if len(recipe.per_pixel_texels):
        carried = recipe.method == "precomputed_transport"
        stages.append(
            Stage(
                part=surface.name,
                name=surface.with_layer("per-pixel texels"),
                method=f"{len(recipe.per_pixel_texels)} directions summed pixel by pixel",
                when="every image",
                evaluations=pixels * len(recipe.per_pixel_texels) * (recipe.channels if carried else per_direction),
                unit="products" if carried else "lobe values",
                why="their edges at the horizon or their highlights are the sharpest: the table would blur them",
            )
        )
    looked_up = Stage(
        part=surface.name,
        name=surface.with_layer("pixels"),
        method=f"looked up in a table of {recipe.rows} × {2 * (recipe.rows or 0)} normals (Catmull-Rom)",
        when="every image",
        evaluations=pixels,
        unit="lookups",
        why=f"{ratio:.0f} times less work in all than pixel by pixel; measured beforehand, its error is {measured:.0e}",
        error=error,
    )
    fixed = recipe.method == "precomputed_transport"
    count = min(checked_pixels(recipe), pixels)
    guard = 0.0 if recipe.guard is None else recipe.guard
    checked = Stage(
        part=surface.name,
        name=surface.with_layer("sampled check"),
        method=f"{count} pixels are summed too; where one is off by more than {guard:.1e}, the whole image is summed",
        when="every image",
        evaluations=count * len(recipe.active_texels) * (recipe.channels if fixed else per_direction),
        unit="products" if fixed else "lobe values",
        why="the error of a table is no bound but a sample: pixels that are not checked are taken to be at most "
        f"{HEADROOM:.0f} times worse than the worst that is"
        + ("" if fixed else "; checked are those where the table is most uneven, and others by turns"),
    )
    return [*stages, looked_up, checked]


PIXELS = 256
"""Maximum number of pixels of a surface at which the error of a constant reflectance is measured, and of a region at
which images under two maps are compared."""


@torch.no_grad()
def alike_from_all_sides(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], limit: float
) -> float | None:
    """Returns the error of a displayed value that a constant reflectance costs a surface in shadow or a floor, if it is
    no more than `limit`; None if it is more, or the surface is no such surface.

    It is HEADROOM times the largest at a sample of pixels, with their own normals and, if `groups` has normals, with
    randomly perturbed ones.
    """
    if "material" in groups or not (surface.visibility is not None or surface.fixed_material):
        return None
    if albedo(surface.material) is None:
        return None
    sample = replace(subset(surface, PIXELS), visibility=None)
    if "normals" in groups:
        sample = _turned(sample, _perturbed(sample.angles, torch.Generator().manual_seed(3)))
    exact = exact_recipe(sky, surface.material.shape[1])
    values = [
        Shader(recipe, sky, sample, illumination)(sample.angles, illumination, sample.material)
        for recipe in (replace(exact, lambert=True), exact)
    ]
    error = HEADROOM * displayed_error(values[0], values[1], sample.base_color)
    return error if error <= limit else None


TABLE_ROWS = (24, 32, 48, 64, 96, 128, 192, 256)
"""Numbers of rows of the tables that are tried."""
CONVERGENCE_ORDER = 3
"""Order of Catmull-Rom interpolation: a table's error falls at best with this power of its mesh width. Tables that
cannot suffice, given an error already measured, are not tried."""
PER_PIXEL_COUNTS = (0, 8, 16, 32, 64, 128)
"""Numbers of directions summed per pixel that are tried with each table."""
ROUGHNESS_ROWS = 48
"""Rows of the table for which the directions are sorted by `roughness`."""
GUARD_FACTOR = 2.0
"""Threshold of the sampled check, as a multiple of the error measured when the plan was made."""
MIN_GUARD_SHARE = 0.5
"""Lower bound of the sampled check's threshold, as a fraction of the tolerance left for it."""
FLOAT32_ERROR = 2e-5
"""Largest displayed error of a float32 sum under smooth lobes. The error under sharp lobes is measured and added."""
LOBES_SHARE = 0.2
"""Share of the tolerance that may be spent on leaving out lobes or replacing them by straight lines."""
LAMBERT_SHARE = 0.9
"""Share of the tolerance that may be spent on leaving out all lobes: little else is then off."""
LOOKUP_COST = 100
"""Cost of a table lookup, in lobe evaluations."""
PRODUCT_COST = 1.0
"""Cost of a product with a stored transport factor, in lobe evaluations; it is limited by memory bandwidth."""
MAX_COST_RATIO = 0.8
"""A table is used only if its cost is below this fraction of the direct sum's."""
AMORTIZED_IMAGES = 50
"""Number of images over which the cost of work done once is divided."""
TRANSPORT_BYTES = 2**28
"""Memory limit of one object's stored transport factors, bytes."""


def exact_recipe(sky: Sky, lobes: int = dsbrdf.LOBES) -> Recipe:
    """Returns the recipe that sums every direction and each of `lobes` lobes at every pixel in float64."""
    every = torch.ones(dsbrdf.CHANNELS, lobes, dtype=torch.bool, device=sky.power.device)
    texels = torch.arange(sky.power.shape[1], device=sky.power.device)
    return Recipe(texels, False, every, ~every, "summed", moving=True, dtype=torch.float64)


def compile_plan(
    surfaces: Sequence[Surface],
    sky: Sky,
    illumination: Tensor,
    groups: Sequence[str],
    tolerance: Tolerance,
    size: tuple[int, int],
    ignored: Iterable[Item] = (),
    n_covered: int | None = None,
    few_images: bool = False,
) -> tuple[list[Recipe], Plan]:
    """Chooses a recipe for each object or layer; returns the recipes and the plan that describes them.

    `illumination` [D] holds the scene's own intensities; `size` is the image's height and width; `ignored` are items of
    what the scene says of its surfaces and no recipe uses; `n_covered` is the number of covered pixels where some show
    several surfaces; with `few_images` no table is made, which would cost more than it saves. The choice is
    deterministic.
    """
    recipes, items, stages, gradients = [], [], [], []
    covered = {surface.name: len(surface.angles) for surface in surfaces}
    pixels = sum(covered.values()) if n_covered is None else n_covered
    items.append(Item(what="pixels", kept=pixels, of=size[0] * size[1], why="the others show the ground alone"))
    unseen = sum(count == 0 for count in covered.values())
    if unseen:
        objects = len({name.removesuffix(IN_SHADOW) for name in covered})
        items.append(Item(what="objects", kept=objects - unseen, of=objects, why="the others are seen by no pixel"))
    items += shadow_items(surfaces)
    items += ignored
    if all(surface.angles.device.type == "cpu" for surface in surfaces) and compiled.library() is None:
        why = f"torch shades, several times slower: {levels.why_none()}"
        items.append(Item(what="compiled kernels", kept=0, of=1, why=why))
    why = "the other groups keep their values" if len(groups) < len(TORCH.groups) else "all are attacked"
    items.append(Item(what="gradients", kept=len(groups), of=len(TORCH.groups), why=why))
    for surface in surfaces:
        if tolerance == "exact" or not len(surface.angles):
            recipe = exact_recipe(sky, surface.material.shape[1])
            if len(surface.angles):
                stages.append(radiance_stage(surface, recipe, len(surface.angles), "exact, as asked", 0.0))
        else:
            own = tolerance * surface.share
            fixed = {"material": surface.fixed_material, "paint": surface.fixed_color}
            moving = [group for group in groups if not fixed.get(group)]
            alike = alike_from_all_sides(surface, sky, illumination, moving, LAMBERT_SHARE * own)
            needed, left_out = _needed(surface, sky, illumination, moving, own, alike)
            items += left_out
            left = own - sum(item.error for item in left_out)
            recipe, chosen = _cheapest(surface, sky, illumination, moving, left, needed, few_images)
            stages += chosen
            exact = exact_recipe(sky, surface.material.shape[1])
            if not few_images:
                gradients += gradient_errors(surface, sky, illumination, moving, recipe, exact)
        recipes.append(recipe)
    return recipes, Plan.of("torch", groups, size, tolerance, items, stages, gradients)


def _needed(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], tolerance: float, alike: float | None
) -> tuple[Recipe, list[Item]]:
    """Returns the work that every method has to do, as a recipe to start from, and the items on what it leaves out."""
    kept, why = _directions(surface, sky, illumination, groups)
    items = [_item(surface, "directions", len(kept), sky.power.shape[1], why)]
    every = torch.ones(surface.material.shape[:2], dtype=torch.bool, device=sky.power.device)
    varying, straight, gray = every, ~every, False
    if alike is not None:
        why = "the material reflects the same share of light in every direction"
        items.append(_item(surface, "lobes", 0, every.numel(), why, alike))
        recipe = Recipe(kept, True, ~every, ~every, "summed", moving="normals" in groups, lambert=True)
        return recipe, items
    if "material" not in groups and surface.viewers is None:
        bounds = lobe_bounds(surface, sky, illumination, groups, kept)
        small = LOBES_SHARE * tolerance / every.shape[1]
        dark, straight = bounds.dark <= small, (bounds.straight <= small) & (bounds.dark > small)
        varying = ~dark & ~straight
        gray = bool((surface.material == surface.material[:1]).all()) and bool(
            (varying == varying[:1]).all() and (straight == straight[:1]).all()
        )
        error = float((bounds.dark * dark + bounds.straight * straight).sum(1).amax())
        why = f"{int(dark.sum())} reflect nothing, {int(straight.sum())} are straight lines in log cos θ_h"
        items.append(_item(surface, "lobes", int(varying.sum()), varying.numel(), why, error))
        if gray:
            items.append(_item(surface, "channels", 1, dsbrdf.CHANNELS, "all three have the same lobes"))
    return Recipe(kept, gray, varying, straight, "summed", moving="normals" in groups), items


def _directions(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str]) -> tuple[Tensor, str]:
    """Returns the indices of the texels that can change the image, and the reason why the others cannot."""
    power = sky.power if attacks_light(groups) else sky.power * illumination
    lit = (power > 0).any(0)
    above = torch.ones_like(lit)
    if "normals" not in groups:
        vectors = to_vectors(surface.angles)
        above = torch.stack([(v @ sky.directions.towards).amax(0) for v in torch.split(vectors, 8192)]).amax(0) > 0
    dark, below = int((~lit).sum()), int((lit & ~above).sum())
    words = [f"{dark} carry no light"] * bool(dark) + [f"{below} are below the horizon of every normal"] * bool(below)
    if surface.visibility is not None:
        shown = (surface.visibility > 0).any(1)
        hidden = int((lit & above & ~shown).sum())
        words += [f"{hidden} are hidden from every pixel"] * bool(hidden)
        above &= shown
    return (lit & above).nonzero()[:, 0], ", ".join(words) or "all carry light that some normal may see"


def _cheapest(
    surface: Surface,
    sky: Sky,
    illumination: Tensor,
    groups: Sequence[str],
    left: float,
    needed: Recipe,
    few_images: bool,
) -> tuple[Recipe, list[Stage]]:
    """Returns the cheapest recipe whose estimated error is within `left`, what the items leave of the tolerance, and
    its stages."""
    pixels = len(surface.angles)
    if needed.lambert:
        recipe = replace(needed, method=_method(needed, groups, pixels, looked_up=False))
        why = "without lobes the sum costs a cosine for each direction"
        if recipe.method == "precomputed_transport":
            why = f"only the light changes: the factors take {_transport_bytes(recipe, pixels) / 1e6:.0f} MB"
        return recipe, [radiance_stage(surface, recipe, pixels, why, FLOAT32_ERROR)]
    direct = replace(needed, method=_method(needed, groups, pixels, looked_up=False, near=surface.viewers is not None))
    rounding = FLOAT32_ERROR + float32_error(surface, sky, illumination, direct)
    if rounding > left:
        wide = replace(direct, dtype=torch.float64)
        return wide, [radiance_stage(surface, wide, pixels, f"float32 would be off by {rounding:.0e}", 0.0)]
    if surface.visibility is not None or surface.viewers is not None:
        why = "the viewer is near" if surface.visibility is None else "objects hide part of the light"
        why += ": radiance depends on the pixel, not on its normal alone"
        return direct, [radiance_stage(surface, direct, pixels, why, rounding)]
    if few_images:
        return direct, [radiance_stage(surface, direct, pixels, "a table would not pay for few images", rounding)]
    measured = MeasuredErrors(surface, sky, illumination, groups, needed)
    why = "a table would cost more"
    limit = (left - rounding) / HEADROOM
    failed: list[tuple[int, int, float]] = []
    for recipe, count in _tables(surface, sky, illumination, groups, direct, measured.angles):
        rows, sharp = recipe.rows or 0, len(recipe.per_pixel_texels)
        if any(sharp <= more and off * min(1, of / rows) ** CONVERGENCE_ORDER >= limit for of, more, off in failed):
            continue
        if too_narrow(surface, sky, illumination, groups, recipe, left):
            failed.append((rows, sharp, limit))
            why = "highlights are narrower than the mesh of any table that costs less"
            continue
        off = measured.error(recipe, limit)
        guarded = replace(recipe, guard=min(limit, max(GUARD_FACTOR * off, MIN_GUARD_SHARE * limit)))
        if off <= limit and _passes_its_check(guarded, surface, sky, illumination):
            return guarded, table_stages(
                surface,
                guarded,
                count,
                ratio=_cost(direct, 0, pixels) / _cost(recipe, count, pixels),
                measured=off,
                error=HEADROOM * (guarded.guard or 0.0) + rounding,
            )
        off = max(off, limit)  # at least, if its check fails: every image would be summed after all
        failed.append((rows, sharp, off))
        why = f"a table of {rows} rows and {sharp} directions beside it may be off by {HEADROOM * off:.1e} or more"
    return direct, [radiance_stage(surface, direct, pixels, why, rounding)]


@torch.no_grad()
def _passes_its_check(recipe: Recipe, surface: Surface, sky: Sky, illumination: Tensor) -> bool:
    """Returns whether the sampled check of a table holds in the scene's own image."""
    shader = Shader(recipe, sky, surface, illumination)
    shader(surface.angles, illumination, surface.material)
    return shader.summed_after_all == 0


def _tables(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], direct: Recipe, reached: Tensor
) -> Iterator[tuple[Recipe, int]]:
    """Yields recipes with tables that cost less than `direct`, and their numbers of nodes, the cheapest first.

    `reached` holds angles that normals may have after an attack: a flat object starts with a single normal and ends
    with one per pixel. The number of nodes is the mean of those needed before and after.
    """
    pixels = len(surface.angles)
    rough = roughness(surface, sky, illumination, groups, ROUGHNESS_ROWS)
    order = direct.active_texels[rough[direct.active_texels].argsort(descending=True, stable=True)]
    candidates = []
    for rows in TABLE_ROWS:
        begun = touched(surface.angles, rows)
        count = int(begun.sum() + (begun | touched(reached, rows)).sum()) * tiles(rows).shape[1] // 2
        kind = _method(direct, groups, count, looked_up=True)
        for sharp in PER_PIXEL_COUNTS:
            if sharp <= len(order) // 2:
                recipe = replace(direct, method=kind, rows=rows, per_pixel_texels=order[:sharp].sort().values)
                candidates.append((_cost(recipe, count, pixels), recipe, count))
    for cost, recipe, count in sorted(candidates, key=lambda candidate: candidate[0]):
        if cost < MAX_COST_RATIO * _cost(direct, 0, pixels):
            yield recipe, count


def _method(recipe: Recipe, groups: Sequence[str], nodes: int, looked_up: bool, near: bool = False) -> Method:
    if "material" in groups or near:
        return "summed"
    if attacks_light(groups):
        # Stored factors do not see normals, by which a shape has its gradient.
        fits = _transport_bytes(recipe, nodes) <= TRANSPORT_BYTES and not {"normals", "shape"} & set(groups)
        return "precomputed_transport" if fits else "summed"
    return "cached_table" if looked_up else "summed"


def _transport_bytes(recipe: Recipe, nodes: int) -> int:
    """Returns the memory of transport factors at `nodes` normals, bytes."""
    return 4 * nodes * len(recipe.active_texels) * recipe.channels


def _cost(recipe: Recipe, nodes: int, pixels: int) -> float:
    """Estimates the cost of one image, in lobe evaluations. Without lobes a direction still costs its cosine."""
    carried = recipe.method == "precomputed_transport"
    each = recipe.channels * (PRODUCT_COST if carried else max(recipe.lobes, 0.3))
    if recipe.rows is None:
        return each * pixels * len(recipe.active_texels)
    at_pixels = pixels * len(recipe.per_pixel_texels) + min(checked_pixels(recipe), pixels) * len(recipe.active_texels)
    at_nodes = (
        nodes
        * (len(recipe.active_texels) - len(recipe.per_pixel_texels))
        / (AMORTIZED_IMAGES if recipe.method == "cached_table" else 1)
    )
    return LOOKUP_COST * pixels + each * (at_pixels + at_nodes)


def _item(surface: Surface, what: str, kept: int, of: int, why: str, error: float = 0.0) -> Item:
    what = surface.with_layer(what)
    return Item(part=surface.name, what=what, kept=kept, of=of, why=why, error=error)


def looked_at(counts: Sequence[int]) -> Tensor:
    """Returns the indices of the pixels that are shaded, int64, in a list of all pixels region by region. `counts` are
    the numbers of pixels of the regions."""
    first, indices = 0, [torch.zeros(0, dtype=torch.int64)]
    for count in counts:
        indices.append(torch.arange(first, first + count)[:: stride(count, PIXELS)])
        first += count
    return torch.cat(indices)


@torch.no_grad()
def map_error(
    surfaces: Sequence[Surface], own: tuple[Sky, Tensor], finest: tuple[Sky, Tensor], seen: Tensor | None = None
) -> float:
    """Returns the largest difference of displayed values between a scene under its `own` map and under the `finest`.

    The light of an object's layers is added up first: `surfaces` of one object have the same pixels, of which the same
    ones are looked at. Each map is given as a sky and its intensities [D], with its own exposure. Both are summed in
    float32, whose error is a thousandth of the differences of interest.

    With shadows, `surfaces` have the visibility of their own map's texels, and `seen` uint8 [D of the finest map, P] is
    that of the finest map's texels from the pixels that `looked_at` names.
    """
    objects: dict[str, list[Surface]] = {}
    for surface in surfaces:
        if len(surface.angles):
            objects.setdefault(surface.name, []).append(subset(surface, PIXELS))
    worst, first = 0.0, 0
    for parts in objects.values():
        last = first + len(parts[0].angles)
        under_finest = [replace(part, visibility=None if seen is None else seen[:, first:last]) for part in parts]
        shaded, truth = (
            torch.stack([_summed(part, *light) for part in shown]).sum(0)
            for shown, light in ((parts, own), (under_finest, finest))
        )
        worst, first = max(worst, displayed_error(shaded, truth, torch.ones_like(truth))), last
    return worst


def _summed(surface: Surface, sky: Sky, intensity: Tensor) -> Tensor:
    """Returns the surface's radiance times its base colour [P, 3], float64."""
    shader = Shader(replace(exact_recipe(sky, surface.material.shape[1]), dtype=torch.float32), sky, surface, intensity)
    return shader(surface.angles, intensity, surface.material).double() * surface.base_color
