"""The plan of the pyrender renderer: which stage each coordinate touches, and what is not drawn."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from services.rendering.image_error import ImageError
from services.rendering.opengl.screen_bounds import Rectangle
from services.rendering.plan import GradientError, Item, Plan, Stage, Tolerance
from services.rendering.protocol import InactiveCoordinate
from services.rendering.pyrender_renderer.batching import SharedPass, alone, shared
from services.rendering.pyrender_renderer.errors import DRAWS, EVERY, HALF_STEP, estimated
from services.rendering.pyrender_renderer.inactive import REACH

if TYPE_CHECKING:
    from services.rendering.opengl.mesh_upload import Drawing
    from services.rendering.protocol import Renderer

STAGES = {"redraw": ("translation", "rotation", "camera"), "relight": ("illumination",), "recolour": ("color",)}
WHY = {
    "redraw": "each side of a difference has a pose or a camera of its own",
    "relight": "other lights on the same surfaces: the sides share one pass over the geometry, an image to an output",
    "recolour": "a colour factor touches one channel: red, green and blue sides share an image, and the pass above",
}


@dataclass(frozen=True)
class Rasterised:
    """How well the rasteriser draws a scene: its largest error at `1 + DRAWS` places, the fewest pixels covered there,
    the faces seen at the start, the errors of gradients there; or why OpenGL draws instead."""

    error: ImageError = field(default_factory=ImageError)
    covered: int = 1
    shown: int = 0
    gradients: tuple[GradientError, ...] = ()
    refusal: str | None = None


def compile_plan(
    renderer: "Renderer",
    drawing: "Drawing",
    groups: Sequence[str],
    tolerance: Tolerance,
    extent: Rectangle,
    watertight: bool,
    rasterised: Rasterised | None,
    most: int,
    idle: Sequence[InactiveCoordinate],
) -> Plan:
    """The plan for attacks on `groups`, with objects within `extent` at the start.

    `watertight`: backfaces of watertight surfaces are not drawn; `rasterised`: whether and how well the rasteriser
    draws, None for "exact"; `most`: images to a pass; `idle`: coordinates that change nothing at the start, moved by at
    most REACH.

    Errors, also those of gradients, are the rasteriser's alone: all else that is left out or shared gives an image the
    very bits it has without.
    """
    height, width = renderer.size
    top, bottom, left, right = extent
    plain = tolerance == "exact"
    faces = sum(piece.faces for piece in drawing.pieces)
    sheets = faces - (sum(piece.n_watertight_faces for piece in drawing.pieces) if watertight else 0)
    textured = [piece for piece in drawing.pieces if piece.texture is not None]
    start = renderer.initial()
    shown = None if rasterised is None or rasterised.refusal is not None else rasterised.shown

    def passes_for(touched: Sequence[str]) -> list[SharedPass]:
        sides = both_sides(start, touched)
        batch = {group: value.double().numpy() for group, value in sides.items()}
        return list(alone(batch) if plain else shared(batch, most))

    passes = len(passes_for(groups))
    coordinates = sum(start[group].numel() for group in groups)
    still = [one for one in idle if one.group in groups]
    items = [
        Item(
            what="coordinates",
            kept=coordinates - len(still),
            of=coordinates,
            why="; ".join(f"{one.name}: {one.why}" for one in still) or f"each may change the image within {REACH:g}",
        ),
        Item(
            what="pixels",
            kept=height * width if plain else (bottom - top) * (right - left),
            of=height * width,
            why="exact: the whole image"
            if plain
            else f"at the start no object is outside rows {top} to {bottom} and columns {left} to {right}; found anew "
            "for every pose",
        ),
        Item(
            what="passes through OpenGL",
            kept=passes if shown is None else 0,
            of=passes,
            why="exact: all are drawn by pyrender's OpenGL"
            if plain
            else _why_opengl(rasterised)
            if shown is None
            else "the rasteriser draws, with passes side by side; OpenGL draws what reaches to the near plane or far "
            "beyond the frame, or is seen from its edge",
        ),
        Item(
            what="faces shaded",
            kept=faces if shown is None else shown,
            of=faces,
            why="OpenGL shades a face before it knows what hides it"
            if shown is None
            else "at the start the others cover no sample or are behind what shows; found anew for every pose",
        ),
        Item(
            what="faces with two sides",
            kept=faces if plain else sheets,
            of=faces,
            why="exact: backfaces are drawn behind everything"
            if plain
            else "the others are of watertight opaque surfaces, whose backfaces are behind their front faces",
        ),
        Item(
            what="parts with a look at their texture",
            kept=len(textured),
            of=len(drawing.pieces),
            why="the others have none",
        ),
        *_surfaces(drawing, len(start["color"])),
    ]
    stages = [
        Stage(
            name="upload",
            method="vertices, faces and textures go to OpenGL's memory",
            when="once",
            evaluations=faces,
            unit="faces",
            why="no coordinate changes them",
        )
    ]
    if rasterised is not None and rasterised.refusal is None:
        stages.append(_rasterise(rasterised, faces))
    for name, touched in STAGES.items():
        attacked = [group for group in groups if group in touched]
        if attacked:
            drawn = passes_for(attacked)
            images = sum(len(one.colors) for one in drawn)
            count = sum(start[group].numel() for group in attacked)
            stages.append(
                Stage(
                    name=name,
                    method=f"{images} images, {len(drawn)} times over the geometry, for both sides of "
                    f"{count} coordinates ({', '.join(attacked)})",
                    when="every image",
                    evaluations=len(drawn),
                    unit="passes a step of all coordinates",
                    why="exact: every image by itself" if plain else WHY[name],
                )
            )
    return Plan.of(
        renderer=renderer.name,
        groups=tuple(groups),
        size=renderer.size,
        tolerance=tolerance,
        items=tuple(items),
        stages=tuple(stages),
        gradients=() if rasterised is None or rasterised.refusal is not None else rasterised.gradients,
        error_is="maximum" if shown is None else "mean",
    )


def _surfaces(drawing: "Drawing", n_objects: int) -> Iterator[Item]:
    """Items of what the options of a scene add to its objects' own surfaces."""
    pieces = drawing.pieces
    given = sum(piece.metallic_roughness is not None and piece.metallic_roughness.given for piece in pieces)
    if given:
        why = "their metallic and roughness are the scene's, by the metallic-roughness BRDF; the others have their own"
        yield Item(what="parts with a given surface", kept=given, of=len(pieces), why=why)
    floor = sum(piece.faces for piece in pieces if piece.index >= n_objects)
    if floor:
        why = "no coordinate moves or recolours them; every image is drawn with them, for lights and objects do"
        yield Item(part="floor", what="faces", kept=floor, of=floor, why=why)


def _rasterise(rasterised: Rasterised, faces: int) -> Stage:
    error = estimated(rasterised.error, rasterised.covered)
    return Stage(
        name="rasterise",
        method="faces and their samples by rules of our own (kernels/coverage.h), what is seen shaded once a pass",
        when="every image",
        evaluations=faces,
        unit="faces",
        why=f"off from OpenGL by {_words(rasterised.error)} at most in {1 + DRAWS} images around the start; estimated "
        f"elsewhere: {_words(error)}; one image in {EVERY} is compared again, and is OpenGL's if it is off by more "
        "than the tolerance",
        error=error.mean,
        share=error.share,
    )


def _why_opengl(rasterised: Rasterised | None) -> str:
    assert rasterised is not None
    found = ""
    if rasterised.gradients:
        off = ", ".join(f"{one.group} {one.relative:.2g}" for one in rasterised.gradients)
        found = f" ({_words(rasterised.error)} in {1 + DRAWS} images around the start; relative errors of central "
        found += f"differences over half-steps of {HALF_STEP:g} at the start: {off})"
    return f"the rasteriser does not draw: {rasterised.refusal}{found}"


def _words(error: ImageError) -> str:
    return f"{error.mean:.1e} in the mean over covered pixels and more than 1/255 in {error.share:.2%} of them"


def both_sides(start: Mapping[str, Tensor], groups: Sequence[str], step: float = 0.01) -> dict[str, Tensor]:
    """Parameters {group: [B, ...]}: those of `start` with each number of `groups` moved up, then down, by `step`."""
    rows: list[dict[str, Tensor]] = []
    for group in groups:
        for index in range(start[group].numel()):
            for sign in (1, -1):
                moved = {name: value.clone() for name, value in start.items()}
                moved[group].view(-1)[index] += sign * step
                rows.append(moved)
    return {name: torch.stack([row[name] for row in rows]) for name in start}
