"""Plans the torch renderer: chooses, for each object and a set of attacked groups, the cheapest method to shade it.

Errors of tables are measured, not derived: at the object's own pixels, for the scene's own values and for random
perturbations of the attacked groups, against the direct sum. A table is ruled out beforehand if it has a highlight
narrower than its mesh, which the measurement may miss. During the attack a sample of pixels is checked in every image
(sampled_check), and the plan states the error that this check enforces.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from services.rendering.plan import Item, Plan, Stage, Tolerance
from services.rendering.torch_renderer import dsbrdf
from services.rendering.torch_renderer import error_estimates as errors
from services.rendering.torch_renderer.declaration import TORCH
from services.rendering.torch_renderer.environment_light import attacks_light
from services.rendering.torch_renderer.gradient_error import gradient_errors
from services.rendering.torch_renderer.lambert_error import alike_from_all_sides
from services.rendering.torch_renderer.lookup_table import tiles, touched
from services.rendering.torch_renderer.normals import to_vectors
from services.rendering.torch_renderer.plan_stages import HEADROOM, radiance_stage, shadow_items, table_stages
from services.rendering.torch_renderer.regions import IN_SHADOW
from services.rendering.torch_renderer.shader import Method, Recipe, Shader, Sky, Surface, checked_pixels

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
) -> tuple[list[Recipe], Plan]:
    """Chooses a recipe for each object or layer; returns the recipes and the plan that describes them.

    `illumination` [D] holds the scene's own intensities; `size` is the image's height and width; `ignored` are items of
    what the scene says of its surfaces and no recipe uses; `n_covered` is the number of covered pixels where some show
    several surfaces. The choice is deterministic.
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
    why = "the other groups keep their values" if len(groups) < len(TORCH.groups) else "all are attacked"
    items.append(Item(what="gradients", kept=len(groups), of=len(TORCH.groups), why=why))
    for surface in surfaces:
        if tolerance == "exact" or not len(surface.angles):
            recipe = exact_recipe(sky, surface.material.shape[1])
            if len(surface.angles):
                stages.append(radiance_stage(surface, recipe, len(surface.angles), "exact, as asked", 0.0))
        else:
            own = tolerance * surface.share
            moving = [group for group in groups if not (group == "material" and surface.fixed_material)]
            alike = alike_from_all_sides(surface, sky, illumination, moving, LAMBERT_SHARE * own)
            needs = _needs(surface, sky, illumination, moving, own, alike)
            items += needs.items
            recipe, chosen = _cheapest(surface, sky, illumination, moving, own, needs)
            stages += chosen
            exact = exact_recipe(sky, surface.material.shape[1])
            gradients += gradient_errors(surface, sky, illumination, moving, recipe, exact)
        recipes.append(recipe)
    return recipes, Plan.of("torch", groups, size, tolerance, items, stages, gradients)


@dataclass(frozen=True)
class _Needs:
    """The work that every method has to do: a recipe to start from, and the plan's items for what it leaves out."""

    recipe: Recipe
    items: list[Item]

    @property
    def error(self) -> float:
        return sum(item.error for item in self.items)


def _needs(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], tolerance: float, alike: float | None
) -> _Needs:
    kept, why = _directions(surface, sky, illumination, groups)
    items = [_item(surface, "directions", len(kept), sky.power.shape[1], why)]
    every = torch.ones(surface.material.shape[:2], dtype=torch.bool, device=sky.power.device)
    varying, straight, gray = every, ~every, False
    if alike is not None:
        why = "the material reflects the same share of light in every direction"
        items.append(_item(surface, "lobes", 0, every.numel(), why, alike))
        recipe = Recipe(kept, True, ~every, ~every, "summed", moving="normals" in groups, lambert=True)
        return _Needs(recipe, items)
    if "material" not in groups and surface.viewers is None:
        bounds = errors.lobe_bounds(surface, sky, illumination, groups, kept)
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
    recipe = Recipe(kept, gray, varying, straight, "summed", moving="normals" in groups)
    return _Needs(recipe, items)


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
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], tolerance: float, needs: _Needs
) -> tuple[Recipe, list[Stage]]:
    """Returns the cheapest recipe whose estimated error fits in the tolerance that the items leave, and its stages."""
    left, pixels = tolerance - needs.error, len(surface.angles)
    if needs.recipe.lambert:
        recipe = replace(needs.recipe, method=_method(needs.recipe, groups, pixels, looked_up=False))
        why = "without lobes the sum costs a cosine for each direction"
        if recipe.method == "precomputed_transport":
            why = f"only the light changes: the factors take {_transport_bytes(recipe, pixels) / 1e6:.0f} MB"
        return recipe, [radiance_stage(surface, recipe, pixels, why, FLOAT32_ERROR)]
    direct = replace(
        needs.recipe, method=_method(needs.recipe, groups, pixels, looked_up=False, near=surface.viewers is not None)
    )
    rounding = FLOAT32_ERROR + errors.float32_error(surface, sky, illumination, direct)
    if rounding > left:
        wide = replace(direct, dtype=torch.float64)
        return wide, [radiance_stage(surface, wide, pixels, f"float32 would be off by {rounding:.0e}", 0.0)]
    if surface.visibility is not None:
        why = "objects hide part of the light: radiance depends on the pixel, not on its normal alone"
        return direct, [radiance_stage(surface, direct, pixels, why, rounding)]
    if surface.viewers is not None:
        why = "the viewer is near: radiance depends on the pixel, not on its normal alone"
        return direct, [radiance_stage(surface, direct, pixels, why, rounding)]
    measured = errors.MeasuredErrors(surface, sky, illumination, groups, needs.recipe)
    why = "a table would cost more"
    limit = (left - rounding) / HEADROOM
    failed: list[tuple[int, int, float]] = []
    for recipe, count in _tables(surface, sky, illumination, groups, direct, measured.angles):
        rows, sharp = recipe.rows or 0, len(recipe.per_pixel_texels)
        if any(sharp <= more and off * min(1, of / rows) ** CONVERGENCE_ORDER >= limit for of, more, off in failed):
            continue
        if errors.too_narrow(surface, sky, illumination, groups, recipe, left):
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
    rough = errors.roughness(surface, sky, illumination, groups, ROUGHNESS_ROWS)
    order = direct.active_texels[rough[direct.active_texels].argsort(descending=True, stable=True)]
    found = []
    for rows in TABLE_ROWS:
        begun = touched(surface.angles, rows)
        count = int(begun.sum() + (begun | touched(reached, rows)).sum()) * tiles(rows).shape[1] // 2
        kind = _method(direct, groups, count, looked_up=True)
        for sharp in PER_PIXEL_COUNTS:
            if sharp <= len(order) // 2:
                recipe = replace(direct, method=kind, rows=rows, per_pixel_texels=order[:sharp].sort().values)
                found.append((_cost(recipe, count, pixels), recipe, count))
    for cost, recipe, count in sorted(found, key=lambda one: one[0]):
        if cost < MAX_COST_RATIO * _cost(direct, 0, pixels):
            yield recipe, count


def _method(recipe: Recipe, groups: Sequence[str], nodes: int, looked_up: bool, near: bool = False) -> Method:
    if "material" in groups or near:
        return "summed"
    if attacks_light(groups):
        fits = _transport_bytes(recipe, nodes) <= TRANSPORT_BYTES
        return "precomputed_transport" if "normals" not in groups and fits else "summed"
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
