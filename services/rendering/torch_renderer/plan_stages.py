"""Describes the steps of a torch renderer's plan as stages."""

from collections.abc import Iterator, Sequence

from services.rendering.plan import Item, Stage
from services.rendering.torch_renderer.shader import Method, Recipe, Surface, checked_pixels
from services.rendering.torch_renderer.visibility import WHOLE

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
