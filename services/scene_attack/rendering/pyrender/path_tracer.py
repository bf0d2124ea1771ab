"""Base class of renderers that draw the pyrender renderer's scene by tracing random paths of light through it.

They have its groups, its ground, its exposure and its display. What differs is how light travels: objects hide the sky
from each other, and light goes on from surface to surface.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack.errors import JobFailure
from scene_attack.process import describe, finite
from scene_attack.rendering.color import over_ground
from scene_attack.rendering.declaration import BuildRequest
from scene_attack.rendering.plan import Item, Plan, Stage, image_error
from scene_attack.rendering.pyrender.parameters import SceneParameters, SceneRenderer
from scene_attack.rendering.pyrender.path_traced import PathTracing
from scene_attack.rendering.pyrender.renderer import EXPOSURE, Ground
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.solids import is_convex, is_opaque
from scene_attack.scenes.view import camera_pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """Values of an image's parameters in world space, float64.

    camera [4, 4]: world from camera, which looks along its −z, +y up. poses [things, 4, 4]: world from mesh, of each of
    `ResolvedScene.placed`; colors [things, 3]: linear factors on their own colours. ambient: mean radiance m of a sky
    of radiance m · (1 + y / 2) in direction (x, y, z). points [n, 4]: radiant intensity, position. directionals [n, 4]:
    irradiance, unit vector towards the light. spots [n, 9]: radiant intensity, position, unit axis, and the scale and
    offset of the fall-off, which is the square of scale · cos(angle from the axis) + offset, clamped to [0, 1].
    """

    camera: Array
    poses: Array
    colors: Array
    ambient: float
    points: Array
    directionals: Array
    spots: Array


class PathTracer(SceneRenderer):
    """Images of a scene as a function of its lights, colours, poses and camera, with the groups of pyrender.

    A subclass has a `declaration`, which `path_traced` makes, and implements `trace` and `tracer`. The image of a frame
    follows from the frame, `samples`, `bounces` and `seed` alone: the images of an attack share the seed, so that the
    noise of both sides of a difference is nearly the same. The exact twin has more samples and a seed of its own.
    """

    def __init__(self, request: BuildRequest) -> None:
        settings: PathTracing = request.settings
        self.scene = request.scene
        self.size = self.scene.description.camera.size
        self.samples, self.seed = settings.samples, settings.seed
        self._attacked, self._tolerance, self._settings = request.groups, request.tolerance, settings
        self._numbers = SceneParameters(self.scene)
        self._ground = Ground(self.scene, self._numbers)
        self.bounces = 0 if shows_no_bounce(self.scene) else settings.bounces
        """Times that light goes on from a surface to another one."""
        self._keeps_own_image = False  # the time of an attack's image is measured by drawing it
        exact: PathTracer = self if request.tolerance == "exact" else copy(self)
        exact.samples, exact.seed, exact._tolerance = settings.verify_samples, settings.seed + 1, "exact"
        exact._keeps_own_image = exact is not self
        exact._twin = exact
        self._twin: PathTracer = exact

    @classmethod
    def build(cls, request: BuildRequest) -> Self:
        """The renderer of a scene."""
        return cls(request)

    @property
    def tracer(self) -> str:
        """The program that traces paths, with its version: "Cycles of Blender 5.0.1"."""
        raise NotImplementedError

    def trace(self, frame: Frame) -> NDArray[np.float32]:
        """Linear radiance times coverage, and coverage, float32 [H, W, 4], the top row first; where no thing is, 0.

        Raises JobFailure.
        """
        raise NotImplementedError

    def unmapped(self) -> Sequence[Item]:
        """Items of the plan on what the scene has and the renderer does not draw. Subclasses may add some."""
        items = []
        for placed in self.scene.placed:
            surfaces = [part.metallic_roughness for part in placed.mesh.parts]
            maps = sum(surface is not None and "occlusion" in surface.maps for surface in surfaces)
            if maps:
                why = "left out: paths find for themselves what hides the sky"
                items.append(Item(part=placed.name, what="occlusion maps", kept=0, of=maps, why=why))
        return items

    @property
    def backend(self) -> str:
        """The tracer, the settings and the processor."""
        how = f"{self.samples} samples, {self.bounces} bounces, seed {self.seed}"
        return f"{self.tracer}, {how}, {describe(torch.device('cpu'))}, torch {torch.__version__}"

    def exact(self) -> "PathTracer":
        """The twin with `verify_samples` samples, under a seed of its own."""
        return self._twin

    def reseeded(self, number: int) -> Self:
        """The same renderer with the seed that is `number` above its own."""
        other = copy(self)
        other.seed += number
        return other

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Images float32 [B, H, W, 3] in [0,1]; `parameters` {group: [B, ...]}. The exact twin keeps the scene's own.

        Raises JobFailure("non-finite") for parameters or radiances that are not finite and as `trace` does, ValueError
        for unknown groups and wrong shapes.
        """
        batch, initial = self._numbers.checked(parameters), self.initial()
        images = []
        for row in range(len(batch["color"])):
            draw = partial(self._image, {group: value[row] for group, value in batch.items()})
            own = all(np.array_equal(value[row], initial[group].numpy()) for group, value in batch.items())
            keeps = own and self._keeps_own_image
            images.append(self.scene.once(("own image", self.backend), draw) if keeps else draw())
        return torch.stack(images)

    def _image(self, values: Mapping[str, Array]) -> Tensor:
        radiance = torch.from_numpy(self.trace(self.frame(values)))
        if not finite(radiance):
            why = "the image has values that are not finite: light or colour is too strong"
            raise JobFailure("non-finite", why)
        return over_ground(radiance, EXPOSURE, self._ground.before(values["camera"]))

    def frame(self, values: Mapping[str, Array]) -> Frame:
        """The frame of the values {group: [...]} of all groups."""
        view = self._numbers.view(values["camera"])
        poses = self._numbers.poses(values["translation"], values["rotation"])
        lit = self._numbers.lit(values["illumination"][None], values["color"][None], view, poses, (0, 0, 0, 0))
        directionals = lit.directionals[0]
        directionals[~directionals[:, 1:].any(axis=1)] = (0.0, 0.0, 1.0, 0.0)  # of no direction: it lights nothing
        return Frame(
            camera=camera_pose(*(float(x) for x in values["camera"])),
            poses=poses,
            colors=lit.colors[0],
            ambient=float(lit.ambients[0]),
            points=lit.points[0],
            directionals=directionals,
            spots=lit.spots[0],
        )

    @property
    def plan(self) -> Plan:
        """The plan, compiled when first asked for: to state errors, it draws the scene with less samples."""
        what = "path tracing", self.backend, self._attacked, self._tolerance, self._settings
        return self.scene.once(what, self._compiled_plan)

    def _compiled_plan(self) -> Plan:
        exact, settings = self._twin, self._settings
        few = exact.reseeded(1)
        few.samples = max(1, exact.samples // 2)
        own, truth, half = (renderer.render({})[0] for renderer in (self, exact, few))
        covered = (truth != self._ground.at_start).any(dim=-1)
        # both have noise: that of `half` has the larger variance, in the ratio of the samples
        spread = float((truth - half)[covered].double().square().mean().sqrt()) if covered.any() else 0.0
        deviation = spread / sqrt(1 + exact.samples / few.samples)
        error, _ = image_error(own, truth, self._ground.at_start)
        height, width = self.size
        shadows = self.scene.description.shadows is not None
        items = [
            Item(
                what="samples of a pixel",
                kept=self.samples,
                of=exact.samples,
                why=f"an exact image has {exact.samples} under a seed of its own; the standard error of a displayed "
                f"value of it is {deviation:.2g}, measured at the start with two seeds",
            ),
            Item(
                what="bounces",
                kept=self.bounces,
                of=settings.bounces,
                why="a single convex, opaque object without a floor: light that leaves it meets no surface again"
                if self.bounces < settings.bounces
                else "light that would go on after these is left out",
            ),
            Item(what="denoisers", kept=0, of=1, why="it would guess from the pixels beside"),
            Item(
                what="kinds of shadows",
                kept=1 + shadows,
                of=2,
                why="of the sky and of all lights" if shadows else "of the sky; of lights the scene asks for none",
            ),
            *self.unmapped(),
        ]
        stage = Stage(
            name="path tracing",
            method=self.tracer,
            when="every image",
            evaluations=self.samples * height * width,
            unit="paths",
            why="all images have the same seed, so that differences have little noise; measured at the start against "
            "the exact image",
            error=error.mean,
            share=error.share,
        )
        return Plan.of(self.name, self._attacked, self.size, self._tolerance, items, [stage], error_is="mean")


def shows_no_bounce(scene: ResolvedScene) -> bool:
    """Whether light that leaves a surface meets none again: a single convex, opaque object, and no floor."""
    [mesh, *others] = [placed.mesh for placed in scene.placed]
    return not others and is_convex(mesh) and all(is_opaque(part) for part in mesh.parts)
