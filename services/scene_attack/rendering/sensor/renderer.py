"""The renderer whose parameters are a camera's settings: it attacks how an image of another renderer is taken.

The base image is rendered once. What the camera does to it has no derivative with respect to all settings, and takes
milliseconds: gradients are differences of images.
"""

from collections.abc import Mapping, Sequence
from dataclasses import astuple
from typing import TYPE_CHECKING

from scene_attack.rendering.declaration import (
    IMAGE_OF,
    BuildRequest,
    Declaration,
    DeclaredRenderer,
    Group,
    labelled,
    register,
)
from scene_attack.rendering.physical_change import Change, ChangedValue, PhysicalChange, Worded, listed, number, signed
from scene_attack.rendering.plan import Item, Plan
from scene_attack.rendering.sensor.settings import GROUPS, LOSSLESS, TWO_SIDED, Sensor, of_shares

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.rendering.protocol import Parameters, Renderer
    from scene_attack.scenes.resolve import ResolvedScene

UNITS = ("stops", "stops", "stops", "pixels", "pixels", "degrees", "ISO", "factor", "factor", "quality")
"""Units of the settings, in the order of `Sensor`."""


def _group(name: str, words: str, explanation: str) -> Group:
    largest = ", ".join(f"{setting} {most:g}" for setting, most in GROUPS[name].items())
    return Group(
        name=name,
        shape=(str(len(GROUPS[name])),),
        unit=f"shares of the largest change: {largest}",
        words=words,
        explanation=explanation,
        labels=labelled(tuple(GROUPS[name])),
        suggested_step=0.05,
        suggested_limit=1.0,
        natural_range="what an ordinary photograph may have",
    )


@register(
    Declaration(
        name="sensor",
        groups=(
            _group("exposure", "exposure", "how long the camera exposes, and its white balance"),
            _group("blur", "focus and motion", "how far it is out of focus, and how far it moves meanwhile"),
            _group("noise", "noise and sharpening", "its sensitivity, which makes noise, and how it sharpens"),
            _group("file", "resolution and JPEG", "the resolution and the quality of the file that it writes"),
        ),
        differentiable=False,
        method="fgsm",
        explanation="changes how a camera takes the image, and nothing in the scene",
        base_renderer="torch",
        worded="scene_attack.rendering.sensor.renderer:worded",
    )
)
class SensorRenderer(DeclaredRenderer):
    """Photographs of one image as a function of the camera's settings: `exposure`, `blur`, `noise` and `file`.

    `image` is [H, W, 3] in [0,1], not rounded: a camera sees the scene itself. `drawn_by` is the backend of the
    renderer that made it.
    """

    def __init__(self, image: "Tensor", drawn_by: str) -> None:
        from PIL import __version__

        self._image = image.float()
        self.size = (int(image.shape[0]), int(image.shape[1]))
        self.backend = f"{IMAGE_OF}{drawn_by}; photographed, Pillow {__version__}"
        settings = Item(
            what="scene", kept=0, of=1, why="its image is rendered once: the attack only changes how it is taken"
        )
        self.plan = Plan.of(self.name, self.groups, self.size, "exact", [settings])

    @classmethod
    def build(cls, request: BuildRequest) -> "SensorRenderer":
        """Makes the renderer of the base renderer's exact image."""
        assert request.base is not None
        start = {group: value[None] for group, value in request.base.initial().items()}
        return cls(request.base.render(start)[0], request.base.backend)

    def initial(self) -> "Parameters":
        """Returns zeros: a camera that changes nothing."""
        return {group: self._image.new_zeros(len(settings), device="cpu") for group, settings in GROUPS.items()}

    def bounds(self) -> "Mapping[str, tuple[Tensor, Tensor]]":
        """Returns −1 or 0 and 1: settings such as the radius of the disc change in one direction only."""
        bounds = {}
        for group, settings in GROUPS.items():
            low = self._image.new_tensor([-float(name in TWO_SIDED) for name in settings], device="cpu")
            bounds[group] = low, low.new_ones(())
        return bounds

    def render(self, parameters: "Mapping[str, Tensor]") -> "Tensor":
        """Returns the photographs [B, H, W, 3] in [0,1], on the device of the base renderer; the noise is one for all.

        Without parameters it is the image itself, [1, H, W, 3].
        """
        import torch

        from scene_attack.rendering.sensor.photograph import photographed

        count = len(next(iter(parameters.values()))) if parameters else 1
        start = {group: value.expand(count, -1) for group, value in self.initial().items()}
        settings = start | dict(parameters)
        images = [
            photographed(self._image[None], of_shares({group: values[k] for group, values in settings.items()}))
            for k in range(count)
        ]
        return torch.cat(images)

    def exact(self) -> "SensorRenderer":
        """Returns itself: nothing is approximated."""
        return self


def worded(
    scene: "ResolvedScene",  # noqa: ARG001 - the declaration's signature
    renderer: "Renderer",
    perturbation: "Mapping[str, Tensor]",
) -> list[Worded]:
    """What the camera does, in a sentence for each group, and the size of each change in its unit."""
    start, result = renderer.initial(), []
    units = iter(UNITS)
    plain = iter(astuple(of_shares(start)))
    changed = iter(astuple(of_shares({group: start[group] + perturbation.get(group, 0) for group in start})))
    for group, settings in GROUPS.items():
        values = [
            ChangedValue(name=name, unit=next(units), before=float(next(plain)), after=float(next(changed)))
            for name in settings
        ]
        if group in perturbation:
            parts = sentences(of_shares(start | {group: start[group] + perturbation[group]}))
            sizes = [
                PhysicalChange(group=group, subject="camera", measure=value.name, value=change, unit=value.unit)
                for value in values
                if (change := value.after - value.before)
            ]
            sentence = listed(parts) if parts else "takes the image as it is"
            result.append(Worded(Change(group=group, subject="camera", sentence=sentence, values=values), sizes))
    return result


def sentences(sensor: Sensor) -> Sequence[str]:
    """What the camera does, stage by stage, e.g. "exposes by +0.4 stops"."""
    return [
        words
        for changes, words in (
            (sensor.defocus, f"is out of focus by {number(sensor.defocus)} pixels"),
            (sensor.motion, f"moves by {number(sensor.motion)} pixels"),
            (sensor.exposure, f"exposes by {signed(sensor.exposure)} stops"),
            (sensor.iso, f"has the noise of ISO {number(sensor.iso)}"),
            (sensor.red, f"shifts red by {signed(sensor.red)} stops"),
            (sensor.blue, f"shifts blue by {signed(sensor.blue)} stops"),
            (sensor.sharpening, f"sharpens by {number(sensor.sharpening)}"),
            (1 - sensor.resolution, f"has {number(100 * sensor.resolution)} % of the resolution"),
            (LOSSLESS - sensor.quality, f"writes a JPEG file of quality {sensor.quality}"),
        )
        if changes
    ]
