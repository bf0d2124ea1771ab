"""The tables of the work-precision report's page on environment maps and on options of scenes."""

from collections.abc import Iterator, Sequence

from services.accuracy.work_precision.clevr_subject import SCENE
from services.accuracy.work_precision.map_resolution import MapRow
from services.accuracy.work_precision.scene_options import SceneRow
from services.accuracy.work_precision.shadow_resolution import ShadowRow
from services.accuracy.work_precision.table_cells import grid, small, table


def maps(rows: Sequence[MapRow]) -> Iterator[str]:
    """What averaging the map down costs."""
    yield from ("## Resolution of the environment map", "")
    yield "A scene's light is its map averaged down to a grid; every other error here is for that grid as it is given."
    yield "Differences of displayed values between exact images, at the scene's own values:"
    yield ""
    yield from table(
        ("mesh", "material", "map", "beside", "pixels>", "largest>", "rms>"),
        [
            [
                *(row.mesh, row.material, grid(row.map), grid(row.reference), f"{row.pixels:,}"),
                *(small(row.largest), small(row.rms)),
            ]
            for row in rows
        ],
    )


def shadows(rows: Sequence[ShadowRow]) -> Iterator[str]:
    """What coarse shadow maps and few samples leave out."""
    yield from ("## Resolution of shadows", "")
    yield "Exact images beside those with the finest shadows; differences of displayed values over covered pixels."
    yield "Seconds are of an image (pyrender) or of the visibility, found once (torch)."
    yield ""
    yield from table(
        ("scene", "renderer", "shadows", "beside", "pixels>", "mean>", "largest>", "seconds>"),
        [
            [
                *(row.scene, row.renderer, row.fineness, row.reference, f"{row.pixels:,}"),
                *(small(row.mean), small(row.largest), f"{row.seconds:.3g}"),
            ]
            for row in rows
        ],
    )


def scenes(rows: Sequence[SceneRow]) -> Iterator[str]:
    """What surfaces, a floor and shadows cost."""
    yield from ("## Surfaces, floor and shadows", "")
    if not rows:
        yield "Not measured yet."
        return
    yield f"{SCENE}: first without options, then with one more in each row. Images some way into an attack"
    yield "on the renderer's default groups, beside the exact ones; differences of displayed values over covered"
    yield "pixels. *Share*: of those that are off by more than 1/255. *Estimate*: the plan's, of the largest error"
    yield "(torch) or of the mean (pyrender). Seconds are of an image."
    yield ""
    yield from table(
        ("scene", "renderer", "tolerance>", "pixels>", "mean>", "share>", "largest>", "estimate>", "seconds>"),
        [
            [
                *(row.scene, row.renderer, small(row.tolerance), f"{row.pixels:,}", small(row.mean)),
                *(f"{row.share:.2%}", small(row.largest), small(row.estimate), f"{row.seconds:.3g}"),
            ]
            for row in rows
        ],
    )
