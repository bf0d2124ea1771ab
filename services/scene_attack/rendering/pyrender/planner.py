"""The plan of the pyrender renderer: the stage that each coordinate touches, the work that is left out, and the error
of the images that stand in for OpenGL's.

The error of rasterised images and of their differences is measured for the plan, and again, for images, while an attack
runs.

Coordinates that cannot change an image are left out, each with its proof. Radiance is linear in the ambient light and
in each energy, but for what glTF materials emit. So what two values of one of these do, all values do: a light that
adds nothing at energy 1 adds nothing at any. In a colour factor it is linear or, for a glTF material that is part
metal, quadratic: what three values do, all do. A light's position is not linear, but the positions from which it
reaches no pixel are a convex set: for every pixel the half-space behind its surface. If they hold six points around a
position, they hold all between.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import acos, pi, sqrt
from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

from scene_attack.rendering.opengl.camera import Rectangle, RenderPass
from scene_attack.rendering.opengl.shadows import box_corners, casters, pass_shadows, shadow_views
from scene_attack.rendering.plan import GradientError, ImageError, Item, Plan, Stage, Tolerance, image_error
from scene_attack.rendering.protocol import InactiveCoordinate, Parameters, Renderer
from scene_attack.rendering.pyrender.batching import SharedPass, alone, shared
from scene_attack.scenes.description import Shadows

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.mesh_upload import Drawing
    from scene_attack.rendering.protocol import Renderer

DRAWS = 5
"""Number of images at random places around the start that are drawn both ways for the plan, beside the start's own."""
MEASURED_REACH = {"illumination": 0.3, "color": 0.3, "translation": 0.1, "rotation": 0.3, "camera": 0.3}
"""Largest distance of these places from the start in each attacked coordinate, by group: as far as attacks move."""
MARGIN = 2.0
"""Safety factor on the largest measured error, for images that were not measured."""
FEW = 4
"""Number of pixels that may differ by an MSAA sample although no measured image did."""
LINE = 0.5
"""Length of the line of pixels that may be off because a face has come to be seen from its edge, where two ways to
interpolate differ most: in sides of a square of as many pixels as are covered. Few of them are off by much."""
EVERY = 128
"""OpenGL draws one image in EVERY of an attack, too."""
HALF_STEP = 0.01
"""Half-step of the central differences whose error is measured, in the groups' units."""
MAX_COORDINATES = 12
"""Maximum number of coordinates of a group whose differences are measured: of each object one, then another."""
GRADIENT_SHARE = 100.0
"""Relative error of a group's gradient that a tolerance of 1 would allow: a tenth at the default tolerance."""


def around(renderer: Renderer, groups: tuple[str, ...]) -> Parameters:
    """The start and DRAWS places around it, {group: [1 + DRAWS, ...]}; the same ones every time."""
    random = torch.Generator().manual_seed(0)
    places, bounds = {}, renderer.bounds()
    for group, value in renderer.initial().items():
        reach = MEASURED_REACH[group] if group in groups else 0.0
        moves = 2 * torch.rand(DRAWS + 1, *value.shape, generator=random, dtype=value.dtype) - 1
        moves[0] = 0.0
        places[group] = torch.clamp(value + reach * moves, *bounds[group])
    return places


def measure(
    renderer: Renderer, behind: Callable[[Parameters], Tensor], groups: tuple[str, ...]
) -> tuple[ImageError, int]:
    """Returns the largest error of the renderer's images around the start, and the fewest pixels that one of them
    covers.

    `behind` returns the ground behind the objects, [3] or [H, W, 3], at parameters {group: [1, ...]}.
    """
    worst, fewest, places = ImageError(), torch.iinfo(torch.int64).max, around(renderer, groups)
    for row, (image, exact) in enumerate(zip(renderer.render(places), renderer.exact().render(places), strict=True)):
        ground = behind({group: value[row : row + 1] for group, value in places.items()})
        error, covered = image_error(image, exact, ground)
        worst, fewest = worst.or_worse(error), min(fewest, covered)
    return worst, fewest


def refusal(error: ImageError, gradients: Sequence[GradientError], tolerance: float) -> str | None:
    """Returns the reason why errors of images and of gradients are beyond the tolerance, as a clause; None if they are
    within it.
    """
    if not ImageError(MARGIN * error.mean, MARGIN * error.share).within(tolerance):
        return "twice its error is beyond the tolerance"
    if any(gradient.relative > GRADIENT_SHARE * tolerance for gradient in gradients):
        return "the error of its gradients is beyond the tolerance"
    return None


def estimated(measured: ImageError, covered: int) -> ImageError:
    """The estimated largest error of an image that was not measured and covers at least `covered` pixels.

    It has room for a few pixels at silhouettes, which are many of a small object's: there the estimate is beyond the
    tolerance, although what was measured is within it.
    """
    flips, line = FEW / covered, LINE / sqrt(covered)
    mean, share = MARGIN * measured.mean + flips / 4, MARGIN * measured.share + max(flips, line)
    return ImageError(min(mean, 1.0), min(share, 1.0))


def measure_gradients(renderer: Renderer, opengl: Renderer, groups: tuple[str, ...]) -> tuple[GradientError, ...]:
    """Errors of the central differences of the renderer's images at the start against `opengl`'s, by attacked group.

    They are the expected errors of the gradient of a sum of the displayed values with normally distributed random
    weights: its relative error is that of the differences of images, in length, and its sign is wrong with probability
    θ / π, where θ is the angle between the two differences. Coordinates that change nothing do not count, and one that
    changes the image of only one of them counts as a wrong sign.
    """
    errors = []
    for group in groups:
        sides = sides_of(renderer.initial(), group)
        ours, exact = (
            (at[::2] - at[1::2]).double().flatten(1) for at in (renderer.render(sides), opengl.render(sides))
        )
        length, error = float(exact.norm()), float((ours - exact).norm())
        angles = [
            acos(max(-1.0, min(1.0, float(own @ true) / float(own.norm() * true.norm()))))
            if own.any() and true.any()
            else pi  # a difference that only one of them has is of no sign in the other
            for own, true in zip(ours, exact, strict=True)
            if own.any() or true.any()
        ]
        relative = error / length if length else float(error > 0)
        wrong_signs = sum(angles) / (pi * len(angles)) if angles else 0.0
        errors.append(GradientError(part="", group=group, relative=relative, wrong_signs=wrong_signs))
    return tuple(errors)


def sides_of(start: Parameters, group: str) -> Parameters:
    """`start` with each of at most MAX_COORDINATES coordinates of a group moved up, then down, {group: [B, ...]}."""
    count = start[group].numel()
    # Three coordinates are an object's: one of each object, along axes in turn, then a second, then the third.
    triples = range(-(-count // 3))
    places = [3 * number + (number + turn) % 3 for turn in range(3) for number in triples]
    chosen = [place for place in places if place < count][:MAX_COORDINATES]
    rows = [row for place in chosen for row in (2 * place, 2 * place + 1)]
    return {name: value[rows] for name, value in both_sides(start, [group], HALF_STEP).items()}


def is_sampled(parameters: Mapping[str, Tensor], row: int) -> bool:
    """Whether OpenGL draws this image of a batch too; its parameters decide, so nothing that was drawn before does."""
    key = b"".join(parameters[group][row].double().numpy().tobytes() for group in sorted(parameters))
    return zlib.crc32(key) % EVERY == 0


Values = Mapping[str, Tensor]

LARGEST_STEP = 0.1
"""The largest half-step of a difference that is ever measured."""


class Linear(Protocol):
    """The part of the renderer that the proofs need: images before exposure, and the objects' places."""

    def initial(self) -> dict[str, Tensor]:
        """The scene's own values."""
        ...

    def names(self, group: str) -> list[str] | None:
        """A word for each coordinate."""
        ...

    def radiance(self, parameters: Values) -> Tensor:
        """Radiance times coverage, and coverage, [B, H, W, 4]."""
        ...

    def out_of_frame(self, parameters: Values, index: int, margin: float, turned: bool) -> bool:
        """Whether an object stays outside the frame wherever it moves by `margin`, or however it is turned."""
        ...


def inactive_coordinates(renderer: Linear, parameters: Values, reach: Mapping[str, float]) -> list[InactiveCoordinate]:
    """Returns the coordinates that do not change the image at `parameters` {group: [...]}, each moved alone by at most
    its group's `reach` up or down; energies, colours and the ambient light by any amount.
    """
    at = {group: parameters.get(group, value).double() for group, value in renderer.initial().items()}
    inactive = _lights(renderer, at, reach.get("illumination", LARGEST_STEP)) + _colors(renderer, at)
    for index in range(len(at["translation"])):
        if renderer.out_of_frame(at, index, reach.get("translation", LARGEST_STEP), turned=False):
            why = "the object is out of the frame, and would be were it moved by as much"
            inactive += [_inactive(renderer, "translation", 3 * index + axis, why) for axis in range(3)]
        if renderer.out_of_frame(at, index, 0.0, turned=True):
            why = "the object is out of the frame however it is turned"
            inactive += [_inactive(renderer, "rotation", 3 * index + axis, why) for axis in range(3)]
    return inactive


def _lights(renderer: Linear, at: Values, reach: float) -> list[InactiveCoordinate]:
    """Returns the inactive coordinates of lights. The ambient light is rendered alone, and so is one unit of each other
    light, at its place and around it.

    The directions from which a directional light reaches no pixel are a convex cone, so that the same six points prove
    them. Those of a spot light, and its positions, are no convex set: they are idle only where it has no energy.
    """
    lights = at["illumination"]
    alone = torch.zeros_like(lights)
    alone[0] = 1.0
    inactive = []
    if _dark(renderer, at, alone):
        inactive.append(_inactive(renderer, "illumination", 0, "no object is in the image"))
    for kind, energy, others in _coordinates(renderer.names("illumination") or [], len(lights)):
        alone = torch.zeros_like(lights)
        alone[energy] = 1.0
        alone[others] = lights[others]
        behind = _dark(renderer, at, alone)
        if behind:
            inactive.append(_inactive(renderer, "illumination", energy, "the light is behind all that is seen"))
        if lights[energy] == 0:
            inactive += [_inactive(renderer, "illumination", place, "the light has no energy") for place in others]
        elif behind and kind != "spot" and all(_dark(renderer, at, moved) for moved in _around(alone, others, reach)):
            why = f"the light is behind all that is seen, and would be from anywhere within {reach:g}"
            inactive += [_inactive(renderer, "illumination", place, why) for place in others]
    return inactive


def _coordinates(names: list[str], count: int) -> Iterator[tuple[str, int, list[int]]]:
    """Yields for each light of the group `illumination` its kind, the index of its energy, and those of its other
    coordinates.
    """
    energies = [index for index, name in enumerate(names) if name.endswith(" energy")]
    for energy, following in zip(energies, [*energies, count][1:], strict=True):
        yield names[energy].split()[0], energy, list(range(energy + 1, following))


def _around(lights: Tensor, places: list[int], reach: float) -> Iterator[Tensor]:
    for place in places:
        for sign in (1, -1):
            moved = lights.clone()
            moved[place] += sign * reach
            yield moved


def _dark(renderer: Linear, at: Values, lights: Tensor) -> bool:
    return not bool(_image(renderer, at, "illumination", lights).any())


def _colors(renderer: Linear, at: Values) -> list[InactiveCoordinate]:
    """Returns the inactive channels of colour factors: those in which images with the object white, black and grey are
    the same.
    """
    inactive = []
    for index in range(len(at["color"])):

        def shown(factor: float, index: int = index) -> Tensor:
            color = at["color"].clone()
            color[index] = factor
            return _image(renderer, at, "color", color)

        black = shown(0.0)
        same = (shown(1.0) == black).flatten(0, 1).all(dim=0)
        if same.any():
            same &= (shown(0.5) == black).flatten(0, 1).all(dim=0)
        why = "the object's colour is not seen: it is black, unlit, hidden or out of the frame"
        inactive += [_inactive(renderer, "color", 3 * index + channel, why) for channel in range(3) if same[channel]]
    return inactive


def _image(renderer: Linear, at: Values, group: str, value: Tensor) -> Tensor:
    """Radiance [H, W, 3] with one group replaced. One at a time: that takes no shader but the one for one image."""
    return renderer.radiance({name: v[None] for name, v in {**at, group: value}.items()})[0, ..., :3]


def _inactive(renderer: Linear, group: str, index: int, why: str) -> InactiveCoordinate:
    names = renderer.names(group)
    return InactiveCoordinate(group, index, names[index] if names else f"{group} {index}", why)


STAGES = {"redraw": ("translation", "rotation", "camera"), "relight": ("illumination",), "recolour": ("color",)}
WHY = {
    "redraw": "each side of a difference has a pose or a camera of its own",
    "relight": "other lights on the same surfaces: the sides share one pass over the geometry, an image to an output",
    "recolour": "a colour factor touches one channel: red, green and blue sides share an image, and the pass above",
}


@dataclass(frozen=True)
class Rasterised:
    """Accuracy of the rasteriser for a scene: its largest error at `1 + DRAWS` places, the fewest pixels covered there,
    the faces seen at the start, and the errors of gradients there; or the reason why OpenGL draws instead.
    """

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

    `watertight`: backfaces of watertight surfaces are not drawn; `rasterised`: the rasteriser's accuracy, or the reason
    why OpenGL draws, None for "exact"; `most`: images to a pass; `idle`: coordinates that change nothing at the start,
    moved by at most LARGEST_STEP.

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
    still = [coordinate for coordinate in idle if coordinate.group in groups]
    items = [
        Item(
            what="coordinates",
            kept=coordinates - len(still),
            of=coordinates,
            why="; ".join(f"{coordinate.name}: {coordinate.why}" for coordinate in still)
            or f"each may change the image within {LARGEST_STEP:g}",
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
            images = sum(len(shared_pass.colors) for shared_pass in drawn)
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
    """Yields items on the surfaces that the options of a scene add to its objects' own."""
    pieces = drawing.pieces
    n_given = sum(piece.metallic_roughness is not None and piece.metallic_roughness.given for piece in pieces)
    if n_given:
        why = "their metallic and roughness are the scene's, by the metallic-roughness BRDF; the others have their own"
        yield Item(what="parts with a given surface", kept=n_given, of=len(pieces), why=why)
    fixed = sum(piece.faces for piece in pieces if piece.index >= n_objects)
    if fixed:
        why = "no coordinate moves or recolours them; every image is drawn with them, for lights and objects do"
        yield Item(part="fixed", what="faces", kept=fixed, of=fixed, why=why)


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
    measured = ""
    if rasterised.gradients:
        off = ", ".join(f"{gradient.group} {gradient.relative:.2g}" for gradient in rasterised.gradients)
        measured = f" ({_words(rasterised.error)} in {1 + DRAWS} images around the start; relative errors of central "
        measured += f"differences over half-steps of {HALF_STEP:g} at the start: {off})"
    return f"the rasteriser does not draw: {rasterised.refusal}{measured}"


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


def with_shadows(plan: Plan, drawing: "Drawing", lit: RenderPass, finer: Shadows, error: float) -> Plan:
    """Returns the plan with its item and its stage of shadows; unchanged if there are none. `lit` is the scene's own
    image, and `error` that of `shadow_error` to one with the shadows `finer`.
    """
    shadows = lit.shadows
    of_lights = None if shadows is None else pass_shadows(lit, shadows)
    if shadows is None or of_lights is None:
        return plan
    own, plain = box_corners(drawing.points)
    corners = [points @ pose[:3, :3].T + pose[:3, 3] for points, pose in zip(own, lit.poses, strict=True)]
    casting = [casters(corners, plain, light) for light in of_lights.lights]
    maps = sum(
        len(shadow_views([corners[k] for k in kept], light))
        for kept, light in zip(casting, of_lights.lights, strict=True)
    )
    texels = shadows.resolution**2
    item = Item(
        what="shadow casters",
        kept=sum(map(len, casting)),
        of=len(corners) * len(casting),
        why="objects times lights; the others are boxes with the light and all other objects before one of their sides",
    )
    stage = Stage(
        name="shadow maps",
        method=f"{maps} maps of {shadows.resolution} × {shadows.resolution} texels for {len(of_lights.lights)} lights, "
        f"{of_lights.samples} samples of each",
        when="every image",
        evaluations=maps * texels,
        unit="texels",
        why=f"the exact image has the same maps, so this costs it no error; {finer.resolution} × {finer.resolution} "
        f"texels and {finer.samples} samples change displayed values by {error:.1e} in the mean over covered pixels; "
        "images of one pass share the maps of lights that agree, and maps stay until an object moves",
    )
    return plan.model_copy(update={"items": (*plan.items, item), "stages": (*plan.stages, stage)})


def shadow_error(image: Tensor, finer: Tensor, covered: Tensor) -> float:
    """The mean difference of displayed values between the scene's own image [H, W, 3] and that with finer shadow maps,
    over the pixels that are `covered` [H, W]; 0 if none is."""
    off = (image - finer).abs().mean(dim=-1)
    return float(off[covered].double().mean()) if bool(torch.any(covered)) else 0.0
