"""The scene from another camera, or with its objects elsewhere or bent: the torch renderer's groups `camera`,
`translation`, `rotation` and `shape`.

Its images are those of a renderer of the scene as it is then, with a plan of its own. That takes a tenth of a second to
make, so the last `KEPT` are kept; no table pays for the few images of each. Light, material and what belongs to an
object's surface are as in the scene itself.

Gradients of poses are central differences of images: surfaces appear and vanish at outlines, which no derivative of
shading shows. Those of a shape, which has thousands of values, are by the normals inside the outlines alone.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.rendering.pose import MovingCamera
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.shape import Shape, limited
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.view import camera_pose, model_matrices

KEPT = 8
"""Renderers of moved scenes that are kept, of 10 MB each at 224²: more than the views that a step usually has."""
HALF_STEP = 0.01
"""Half-step of the differences, radians and scene units: about a pixel at the outline of an object that fills 224²."""


def places(scene: ResolvedScene) -> Parameters:
    """The scene's own values of the moving groups, float64, rounded to float32: translations and rotation vectors
    [objects, 3] in scene units and radians, and the camera's coordinates [4] (`pose.MovingCamera`)."""
    things = scene.description.objects
    values = {
        "translation": torch.tensor([thing.translation for thing in things], dtype=torch.float64),
        "rotation": torch.tensor([thing.rotation for thing in things], dtype=torch.float64),
        "camera": MovingCamera(scene).initial,
    }
    return {group: value.float().double() for group, value in values.items()}


def moved(scene: ResolvedScene, values: Mapping[str, Tensor]) -> ResolvedScene:
    """The scene with other values of some of the groups of poses. A floor stays where it is."""
    at = {group: value.double().numpy() for group, value in (places(scene) | dict(values)).items()}
    models, view = scene.models, scene.view
    if "translation" in values or "rotation" in values:
        scales = torch.tensor([thing.scale for thing in scene.description.objects], dtype=torch.float64).numpy()
        models = tuple(model_matrices(at["translation"], at["rotation"], scales))
    if "camera" in values:
        view = camera_pose(*at["camera"].tolist())
    return replace(scene, models=models, view=view)


class Draws(Protocol):
    """A renderer of one scene."""

    def initial(self) -> Parameters:
        """The scene's own values by group."""
        ...

    def still(self, parameters: Parameters, drawn: Tensor | None = None) -> Tensor:
        """The image [H, W, 3] of the scene where it is, of values of the other groups; by the shape `drawn`, which it
        has, it is differentiable."""
        ...


class MovedScenes:
    """Draws a scene that is moved. `own` is the renderer of the scene where it is, `make` makes that of another one,
    given the shape that its objects have been given."""

    def __init__(self, scene: ResolvedScene, own: Draws, make: Callable[[ResolvedScene, Shape | None], Draws]) -> None:
        self._scene, self._own, self._make = scene, own, make
        self._start = places(scene)
        self._kept: OrderedDict[bytes, Draws] = OrderedDict()
        self._last: tuple[Tensor, ResolvedScene] | None = None

    def image(self, place: Parameters, rest: Parameters) -> Tensor:
        """The image [H, W, 3] of values of moving groups, `place`, and of the other groups; differentiable by both.

        Raises ValueError for other normals than the scene's own from elsewhere: they belong to the pixels of one view.
        """
        bends = place.get("shape")
        poses = {group: value for group, value in place.items() if group != "shape"}
        drawn = None if bends is None else limited(bends.double())
        image = self._drawn(poses, drawn, rest)
        if any(value.requires_grad for value in poses.values()):
            still = {group: value.detach() for group, value in rest.items()}
            sizes = [value.numel() for value in poses.values()]

            def draw(values: Tensor) -> Tensor:
                parts = zip(poses.items(), torch.split(values, sizes), strict=True)
                at = {group: part.view_as(value) for (group, value), part in parts}
                return self._drawn(at, None if drawn is None else drawn.detach(), still)

            zeros: Tensor = _Differences.apply(  # type: ignore[no-untyped-call]
                torch.cat([value.flatten() for value in poses.values()]), draw, image.detach()
            )
            image = image + zeros
        return image

    def _drawn(self, poses: Parameters, drawn: Tensor | None, rest: Parameters) -> Tensor:
        at = {group: value.detach().cpu() for group, value in poses.items()}
        at = {group: value for group, value in at.items() if not torch.equal(value, self._start[group].to(value.dtype))}
        shape = Shape(drawn.detach().cpu()) if drawn is not None and bool(drawn.any()) else None
        if (at or shape) and "normals" in rest:
            own = self._own.initial()["normals"]
            if not torch.equal(rest["normals"].detach().cpu(), own):
                raise ValueError("normals belong to the pixels of one view; they cannot be changed in a moved scene")
            rest = {group: value for group, value in rest.items() if group != "normals"}
        renderer = self._at(at, shape) if at or shape else self._own
        return renderer.still(rest, drawn if drawn is not None and drawn.requires_grad else None)

    def _at(self, poses: Parameters, shape: Shape | None) -> Draws:
        """The renderer of the scene elsewhere or in another shape: kept, or made."""
        values = poses if shape is None else poses | {"shape": shape.drawn}
        key = b"".join(group.encode() + value.double().numpy().tobytes() for group, value in values.items())
        try:
            renderer = self._kept.pop(key, None) or self._moved(poses, shape)
        except InvalidRequest as error:
            detail = f"{', '.join(values)} left nothing to draw ({error.detail}); give a smaller `epsilon` or `bounds`"
            raise JobFailure("internal", detail) from error
        self._kept[key] = renderer
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return renderer

    def _moved(self, poses: Parameters, shape: Shape | None) -> Draws:
        if shape is None:
            return self._make(moved(self._scene, poses), None)
        if self._last is None or not torch.equal(self._last[0], shape.drawn):  # all views of a step have the same shape
            self._last = shape.drawn, replace(self._scene, meshes=shape.meshes(self._scene.meshes))
        return self._make(moved(self._last[1], poses), shape)


class _Differences(torch.autograd.Function):
    """Zeros, of the shape of an image, whose derivative by the values [n] is that of `draw` by central differences.

    They are drawn at once, with the image: a derivative may be asked for in a thread that OpenGL does not belong to.
    """

    @staticmethod
    @torch.no_grad()
    def forward(ctx: Any, values: Tensor, draw: Callable[[Tensor], Tensor], image: Tensor) -> Tensor:
        steps = HALF_STEP * torch.eye(len(values)).to(values)
        ctx.slopes = [(draw(values + step) - draw(values - step)) / (2 * HALF_STEP) for step in steps]
        ctx.like = values
        return torch.zeros_like(image)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return torch.stack([(gradient.double() * slope).sum() for slope in ctx.slopes]).to(ctx.like), None, None
