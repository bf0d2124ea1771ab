"""Lights, colours, poses and a camera, rendered by pyrender: the non-differentiable renderer (paper, section 4.1)."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack.errors import JobFailure
from scene_attack.process import finite
from scene_attack.rendering.color import over_ground
from scene_attack.rendering.declaration import BuildRequest
from scene_attack.rendering.opengl import context, gbuffer
from scene_attack.rendering.opengl.camera import CameraMatrices, Rectangle, RenderPass, beyond, rectangle
from scene_attack.rendering.opengl.shadows import check_size, images_per_pass, pass_shadows
from scene_attack.rendering.plan import DEFAULT_TOLERANCE, ImageError, Plan, Tolerance, image_error
from scene_attack.rendering.pose import seen_from
from scene_attack.rendering.protocol import InactiveCoordinate, Parameters, Renderer
from scene_attack.rendering.pyrender import planner, rasteriser
from scene_attack.rendering.pyrender.batching import Array, SharedPass, alone, fill, shared
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.parameters import SceneParameters, SceneRenderer
from scene_attack.rendering.pyrender.planner import (
    Rasterised,
    compile_plan,
    inactive_coordinates,
    shadow_error,
    with_shadows,
)
from scene_attack.rendering.pyrender.rasteriser import SAMPLES
from scene_attack.rendering.variation import Variation
from scene_attack.scenes.resolve import ResolvedScene

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.mesh_upload import Drawing
    from scene_attack.rendering.opengl.render_pass import Backfaces

MAX_BACKFACE_MISMATCH = 0.01
"""Largest share of covered pixels that the backfaces of watertight surfaces may change. At silhouettes depths of both
sides round to the same number; a surface that passes through itself changes more and is not taken for watertight."""


def draw_by_opengl(
    drawing: "Drawing", lit: RenderPass, size: tuple[int, int], backfaces: "Backfaces"
) -> NDArray[np.float32]:
    """The radiance [images, rows, columns, 4] of the pass's part, the bottom row first.

    `size` is the height and width of the whole image; `backfaces` is the treatment of those of watertight surfaces.
    """
    images: NDArray[np.float32] = context.current().renderer.draw(
        drawing,
        "radiance.frag",
        lit.view,
        lit.poses,
        lit.colors,
        lit.uniforms,
        {},
        size=size,
        samples=SAMPLES,
        outputs=len(lit.colors),
        blend=True,
        lights=lit.light_counts,
        rectangle=lit.part,
        backfaces=backfaces,
        shadows=None if lit.shadows is None else pass_shadows(lit, lit.shadows),
    )
    return images


def looks_watertight(natural: NDArray[np.float32], outside: NDArray[np.float32]) -> bool:
    """Whether the backfaces of watertight surfaces show nowhere: the first of two images [..., 4] has them. Radiance
    is on the scale of the display, and coverage is last.
    """
    changed = np.abs(outside - natural).max(axis=-1) > 1 / 255
    return bool(changed.sum() <= MAX_BACKFACE_MISMATCH * (natural[..., 3] > 0).sum())


CAMERAS = 32
"""Number of cameras whose view of a map is kept: more than the two sides of each coordinate's difference."""


class Ground:
    """Displayed values behind the objects: one colour [3], or an image [H, W, 3]. A map is seen from each camera; a
    colour and an image stay as they are.
    """

    def __init__(self, scene: ResolvedScene, parameters: SceneParameters) -> None:
        self._scene = scene
        self._parameters = parameters
        self.at_start = torch.tensor(scene.ground, dtype=torch.float32)
        self._start = parameters.initial()["camera"].numpy().tobytes()
        self._seen = lru_cache(CAMERAS)(self._from)

    def before(self, camera: Array) -> Tensor:
        """Returns the displayed values behind the objects for a camera of coordinates [4]."""
        key = np.asarray(camera, np.float64).tobytes()
        return self.at_start if key == self._start or not self._scene.shows_map else self._seen(key)

    def at(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Returns the same as `before`, at parameters {group: [1, ...]}."""
        return self.before(self._parameters.checked(parameters)["camera"][0])

    def before_each(self, cameras: Array, size: tuple[int, int]) -> Tensor:
        """Returns images [B, H, W, 3] of the displayed values behind the objects for cameras of coordinates [B, 4]."""
        return torch.stack([self.before(camera).expand(*size, 3) for camera in cameras])

    def _from(self, key: bytes) -> Tensor:
        view = self._parameters.view(np.frombuffer(key, np.float64))
        return torch.tensor(self._scene.ground_from(view.clip_from_world), dtype=torch.float32)

    def part(self, camera: Array, part: tuple[int, int, int, int]) -> Tensor:
        """Returns the same as `before` in rows from and to and columns from and to, the bottom row first as OpenGL has
        them.
        """
        ground = self.before(camera)
        top, bottom, left, right = part
        return ground if ground.dim() == 1 else ground[top:bottom, left:right].flip(0)


EXPOSURE = 0.5
"""Radiance times this is the linear image: a white surface that faces the default light from 2.5 away (radiance 2.0
with the ambient light) is just the display's white. EfficientNet-Lite0 does as well from 0.4 to 0.8."""
MAX_IMAGES_PER_PASS = 8
"""Images drawn in one pass over the geometry: as many outputs as every driver has."""
MAX_SAMPLE_BYTES = 2**26
"""Bytes of samples that the images of a pass may take; a single one may take more."""
ROUNDING = 1e-3
"""Margin, in scene units and as a share of the move, by which an object must be beyond the frame to be outside."""


class PyrenderRenderer(SceneRenderer):
    """Images of a scene as a function of its lights, colours, poses and camera.

    Groups, all float tensors, are declared in `declaration`: `illumination`, `color`, `translation`, `rotation` and
    `camera`. With one object and one point light the first four are the paper's 14 numbers.

    A Lambertian body under a thin glossy coat, or the metallic-roughness material of a glTF file, lit without shadows
    or bounces: `shaders/radiance.frag` has the formulas. Silhouettes are multisampled; the ground is composited as
    displayed, by coverage. Of watertight surfaces only the outside is seen. Everything is drawn in the process's one
    OpenGL context, so only the thread that used it first may render.

    The images of a batch share what they can (`batching`), and nothing is drawn where no object is, at no cost. Without
    a GPU the rasteriser draws instead of OpenGL if its error, measured when the renderer is made, is within tolerance
    (`planner`), and so is that of its gradients. `exact` has OpenGL draw every image by itself and whole.
    """

    declaration = PYRENDER

    def __init__(
        self, scene: ResolvedScene, groups: Sequence[str] | None = None, tolerance: Tolerance = DEFAULT_TOLERANCE
    ) -> None:
        """Makes the renderer for attacks on `groups` (None: the default groups). For the meaning of a tolerance see
        `scene_attack.rendering.plan`.
        """
        self.backend = context.current().backend
        from scene_attack.rendering.opengl.mesh_upload import closed_drawing  # imports OpenGL, so after the context

        self.size = scene.description.camera.size
        meshes = tuple(placed.mesh for placed in scene.placed)
        self.drawing = closed_drawing(meshes)  # public, for passes of one's own over it
        self._has_floor = scene.description.floor is not None
        self._numbers = SceneParameters(scene)
        self._ground = Ground(scene, self._numbers)
        samples = rasteriser.SAMPLES * self.size[0] * self.size[1]
        most = min(MAX_IMAGES_PER_PASS, MAX_SAMPLE_BYTES // (16 * samples), images_per_pass(scene.description))
        self._most = max(1, most)
        self._attacked = tuple(groups or self.declaration.default_groups)
        self._tolerance: Tolerance = "exact"
        self._rasterised: Rasterised | None = None
        self._rasterises = False
        self._sampled: ImageError | None = None
        self._once = scene.once
        self._watertight = scene.once("backfaces show nowhere", self._is_watertight_at_start)
        self._twin: PyrenderRenderer = self
        if tolerance != "exact":
            self._twin = copy(self)
            self._twin._twin, self._tolerance = self._twin, tolerance
            what = "rasterised", self._attacked, tolerance
            is_known = what in scene.measured
            self._rasterised = scene.once(what, lambda: self._try_rasteriser(self._attacked, tolerance))
            self._rasterises = self._rasterised.refusal is None
            if self._rasterises and is_known and any(piece.texture is not None for piece in self.drawing.pieces):
                self._twin.render({})  # uploads the textures, whose mipmaps the rasteriser takes

    @classmethod
    def build(cls, request: BuildRequest) -> "PyrenderRenderer":
        """The renderer of a scene. Raises InvalidRequest("scene.objects") if nothing of it can be seen, and
        InvalidRequest("scene.shadows.resolution") if its shadow maps would take too much memory."""
        check_size(request.scene.description)
        gbuffer.check_in_view(request.scene)
        return cls(request.scene, request.groups, request.tolerance)

    @property
    def plan(self) -> Plan:
        """The plan, compiled when first asked for: to state the error of shadows, finer ones are drawn."""
        return self._once(("plan", self._attacked, self._tolerance), self._compiled_plan)

    def _compiled_plan(self) -> Plan:
        plan = compile_plan(
            self,
            self.drawing,
            self._attacked,
            self._tolerance,
            extent=self.extent(self.initial()),
            watertight=self._watertight,
            rasterised=self._rasterised,
            most=self._most,
            idle=[] if self._plain else self.inactive(self.initial(), {}),
        )
        numbers = self._numbers.with_finer_shadows()
        if numbers.shadows is None:
            return plan
        finer, own = copy(self._twin), self._twin.radiance({})[0]
        finer._numbers = numbers
        error = shadow_error(over_ground(own, EXPOSURE, self._ground.at_start), finer.render({})[0], own[..., 3] > 0)
        return with_shadows(plan, self.drawing, self._at_start(), numbers.shadows, error)

    def _try_rasteriser(self, groups: tuple[str, ...], tolerance: float) -> Rasterised:
        """Measures the rasteriser and lets it draw if it is within the tolerance (`_rasterises`); returns its accuracy,
        or the reason why OpenGL draws.
        """
        why = rasteriser.refusal(self.drawing, start := self._at_start())
        if why is None and not context.current().software:
            why = "a graphics card is faster"
        if why is None and start.part[0] == start.part[1]:
            why = "nothing is in the image at the start, so that its error cannot be measured"
        if why is not None:
            return Rasterised(refusal=why)
        self._twin.render({})  # uploads the textures, as above
        [drawn] = self._by_rasteriser([start])
        if drawn is None:
            return Rasterised(refusal="a face reaches to the camera or far beyond the frame, or is seen from its edge")
        opengl = copy(self)
        self._rasterises = True
        error, covered = planner.measure(self, self._ground.at, groups)
        gradients = planner.measure_gradients(self, opengl, groups)
        self._sampled = None
        why = planner.refusal(error, gradients, tolerance)
        self._rasterises = why is None
        return Rasterised(error, covered, drawn[1], gradients, why)

    @property
    def _plain(self) -> bool:
        return self._tolerance == "exact"

    @property
    def rasterises(self) -> bool:
        """Whether the rasteriser draws what it can, and not OpenGL."""
        return self._rasterises

    @property
    def sampled_error(self) -> ImageError | None:
        """The largest error of the images rendered so far that OpenGL drew too; None if it drew none of them."""
        return self._sampled

    def exact(self) -> "PyrenderRenderer":
        """The twin that has OpenGL draw every image by itself, whole, with the backfaces of watertight surfaces."""
        return self._twin

    @property
    def watertight(self) -> bool:
        """Whether backfaces of watertight surfaces are not drawn: only if at the start they show nowhere."""
        return self._watertight

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Images float32 [B, H, W, 3] in [0,1]; `parameters` {group: [B, ...]}. An object out of frame leaves ground.

        Raises JobFailure("non-finite") for parameters or radiances that are not finite, ValueError for unknown groups
        and wrong shapes.
        """
        batch = self._numbers.checked(parameters)
        behind = self._ground.before_each(batch["camera"], self.size)
        images = self._draw(batch, behind, lambda radiance, ground: over_ground(radiance, EXPOSURE, ground))
        for row in range(len(images)):
            if self._rasterises and planner.is_sampled(parameters, row):
                images[row] = self._verified(images[row], {g: v[row : row + 1] for g, v in parameters.items()})
        return images

    def _verified(self, image: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """The image, or OpenGL's where it is off by more than the tolerance allows."""
        exact = self._twin.render(parameters)[0]
        error, _ = image_error(image, exact, self._ground.at(parameters))
        self._sampled = error.or_worse(self._sampled)
        return image if self._tolerance != "exact" and error.within(self._tolerance) else exact

    def radiance(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Linear, unclamped radiance times coverage, and coverage: float32 [B, H, W, 4]. Before exposure and display.

        Strictly linear in the ambient light and in each light's energy, but for what glTF materials emit. Raises as
        `render` does.
        """
        batch = self._numbers.checked(parameters)
        return self._draw(batch, torch.zeros(len(batch["color"]), *self.size, 4), lambda radiance, _: radiance)

    def extent(self, parameters: Mapping[str, Tensor]) -> Rectangle:
        """Rows from and to, columns from and to, within which the objects are at `parameters` {group: [...]}."""
        batch = self._numbers.checked({group: value[None] for group, value in parameters.items()})
        view = self._numbers.view(batch["camera"][0])
        return self._extent(view, self._numbers.poses(batch["translation"][0], batch["rotation"][0]))

    def out_of_frame(self, parameters: Mapping[str, Tensor], index: int, margin: float, turned: bool) -> bool:
        """Whether an object at `parameters` {group: [...]} covers nothing wherever it is moved by at most `margin`
        (scene units), and, if `turned`, however it is turned. False where that is not sure.
        """
        batch = self._numbers.checked({group: value[None] for group, value in parameters.items()})
        pose = self._numbers.poses(batch["translation"][0], batch["rotation"][0])[index]
        corners = pose @ self.drawing.points[index]
        if turned:  # the ball around the object's own origin that holds it
            centre = np.append(pose[:3, 3], 1.0)
            margin += float(np.linalg.norm(corners[:3] - centre[:3, None], axis=0).max())
            corners = centre[:, None]
        view = self._numbers.view(batch["camera"][0])
        return beyond(corners, view.clip_from_world, margin * (1 + ROUNDING) + ROUNDING)

    def inactive(self, parameters: Mapping[str, Tensor], reach: Mapping[str, float]) -> list[InactiveCoordinate]:
        """Returns `inactive_coordinates`. With shadows they are those without, as a shadow only takes light away,
        except poses: an object out of the frame may cast its shadow into it.
        """
        plain = copy(self)
        plain._numbers = self._numbers.unshadowed()
        inactive = inactive_coordinates(plain, parameters, reach)
        moves = () if self._numbers.shadows is None else ("translation", "rotation")
        return [coordinate for coordinate in inactive if coordinate.group not in moves]

    def _draw(self, batch: Mapping[str, Array], empty: Tensor, finish: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
        """Writes `finish` of radiance [..., 4] and ground into `empty` [B, H, W, C] where objects are; returns it.
        First all is drawn, then all is finished: threads of torch that wait for work in between would be in the way of
        those that draw.
        """
        passes = [(drawn, self._lit(drawn)) for drawn in (alone(batch) if self._plain else shared(batch, self._most))]
        passes = [(drawn, lit) for drawn, lit in passes if lit.part[0] < lit.part[1]]
        for (drawn, lit), frames in zip(passes, self._frames([lit for _, lit in passes]), strict=True):
            top, bottom, left, right = lit.part
            if not finite(radiance := torch.from_numpy(frames)):
                why = "the image has values that are not finite: light or colour is too strong"
                raise JobFailure("non-finite", why)
            ground = self._ground.part(drawn.camera, lit.part)
            shown = finish(radiance, ground).numpy()[:, ::-1]  # OpenGL's first row is the bottom one
            fill(empty.numpy()[:, top:bottom, left:right], drawn, shown)
        return empty

    def _extent(self, view: CameraMatrices, poses: NDArray[np.float64]) -> Rectangle:
        return rectangle(self.drawing.points, list(view.clip_from_world @ poses), self.size)

    def _lit(self, drawn: SharedPass) -> RenderPass:
        """The render pass of a shared pass: of the part of the image where objects are, or of all of it to be exact."""
        view, poses = self._numbers.view(drawn.camera), self._numbers.poses(drawn.translation, drawn.rotation)
        part = (0, self.size[0], 0, self.size[1]) if self._plain else self._extent(view, poses)
        return self._numbers.lit(drawn.illuminations, drawn.colors, view, poses, part)

    def _frames(self, passes: Sequence[RenderPass]) -> list[NDArray[np.float32]]:
        """Radiance [images, rows, columns, 4] of each pass's part, the bottom row first."""
        if not self._rasterises or not passes:
            return [self._by_opengl(lit) for lit in passes]
        drawn = self._by_rasteriser(passes)
        return [self._by_opengl(lit) if own is None else own[0] for lit, own in zip(passes, drawn, strict=True)]

    def _by_rasteriser(self, passes: Sequence[RenderPass]) -> list[tuple[NDArray[np.float32], int] | None]:
        positions = context.current().renderer.sample_positions
        return rasteriser.draw(self.drawing, passes, self.size, positions, self._watertight, self._has_floor)

    def _by_opengl(self, lit: RenderPass) -> NDArray[np.float32]:
        """The radiance of one pass as `_frames` has it, drawn by OpenGL."""
        hidden: Literal["behind", "cull"] = "behind" if self._plain else "cull"
        return draw_by_opengl(self.drawing, lit, self.size, hidden if self._watertight else "draw")

    def _at_start(self) -> RenderPass:
        """The scene's own image as a pass."""
        [start] = alone(self._numbers.checked({}))
        return self._lit(start)

    def _is_watertight_at_start(self) -> bool:
        """Whether there are watertight surfaces, and their backfaces show nowhere in the scene's own image."""
        self._watertight = False
        if not any(piece.n_watertight_faces for piece in self.drawing.pieces):
            return False
        start = replace(self._at_start(), part=(0, self.size[0], 0, self.size[1]), shadows=None)
        natural, self._watertight = self._by_opengl(start), True
        return looks_watertight(EXPOSURE * natural, EXPOSURE * self._by_opengl(start))


def varied(renderer: Renderer, parameters: Mapping[str, Tensor], variation: Variation) -> Parameters:
    """Returns the values [B, …] by group under a variation of view and light.

    Ambient light and energies are multiplied; lights stay in place.
    """
    names = renderer.names("illumination") or []
    energies = [name == "ambient" or name.endswith("energy") for name in names]
    factor = torch.where(torch.tensor(energies), variation.intensity, 1.0)
    result = dict(parameters)
    if "illumination" in result:
        result["illumination"] = result["illumination"] * factor.to(result["illumination"].dtype)
    if "camera" in result:
        result["camera"] = seen_from(result["camera"], variation)
    return result
