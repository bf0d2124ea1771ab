"""A perturbation in words of the scene: in degrees, centimetres and percent, in sentences, and as images.

Each renderer has the words for its own groups (`Declaration.worded`, `Declaration.drawn`).
"""

from collections.abc import Mapping, Sequence
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.errors import named
from scene_attack.rendering.declaration import RENDERERS

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.rendering.protocol import Renderer
    from scene_attack.scenes.resolve import ResolvedScene


class PhysicalChange(BaseModel):
    """The size of the change of one thing in the scene."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    group: str
    subject: str = Field(description='what was changed: "object 0", "point 0 energy", "map"')
    measure: str = Field(description='what is measured of it: "angle", "distance", "largest change"')
    value: float = Field(description="signed where it is a single number, else the size of the change")
    unit: str = Field(description='"degrees", "cm", "scene units", "%", or the unit that the group declares')


class ChangedValue(BaseModel):
    """A number of the scene before and after the attack."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(description='"object 0 translation x", "point 0 energy"')
    unit: str
    before: float
    after: float


class ChangeImage(BaseModel):
    """A file among a job's that shows a change."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    words: str


class Curve(BaseModel):
    """A quantity over an angle, before and after the attack."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    angles: list[float] = Field(description="degrees")
    before: list[float]
    after: list[float]


class Change(BaseModel):
    """What an attack did to one thing in the scene: a sentence, and the numbers behind it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    group: str
    subject: str = Field(description='what was changed: "piano", "lamp", "surface normals"')
    sentence: str = Field(description='"moved 4.2 cm right and 1.1 cm up"; what was changed is its grammatical subject')
    values: list[ChangedValue]
    images: list[ChangeImage] = Field(default_factory=list, description="images of it, among the job's files")
    curves: list[Curve] = Field(
        default_factory=list,
        description="of a material its reflectance, in 1/steradian, towards viewers in the plane of incidence of light "
        "at 45°, by the viewer's angle from the normal",
    )


class Worded(NamedTuple):
    """The change of one thing in words, and its sizes."""

    change: Change
    sizes: Sequence[PhysicalChange]


def worded(scene: "ResolvedScene", renderer: "Renderer", perturbation: "Mapping[str, Tensor]") -> list[Worded]:
    """What a perturbation changes in a scene, by group and by thing.

    For a renderer that declares no words it is the largest change of a coordinate of each group, in the group's own
    unit; the numbers before are then 0.
    """
    declared = RENDERERS[renderer.name]
    if declared.worded is not None:
        with named(f"renderer {renderer.name!r}"):
            result: list[Worded] = resolve_name(declared.worded)(scene, renderer.exact(), perturbation)
            return result
    result = []
    for name, value in perturbation.items():
        group, largest = declared.group(name), float(value.flatten()[value.abs().argmax()])
        measure = "largest change"
        size = PhysicalChange(group=name, subject=group.words, measure=measure, value=largest, unit=group.unit)
        sentence = f"{measure} {signed(largest)} ({group.unit})"
        values = [from_zero(size, group.words)]
        result.append(Worded(Change(group=name, subject=group.words, sentence=sentence, values=values), [size]))
    return result


def physical_changes(
    scene: "ResolvedScene", renderer: "Renderer", perturbation: "Mapping[str, Tensor]"
) -> list[PhysicalChange]:
    """The sizes of the changes that a perturbation makes in a scene."""
    return [size for thing in worded(scene, renderer, perturbation) for size in thing.sizes]


def changes_in_words(
    scene: "ResolvedScene", renderer: "Renderer", perturbation: "Mapping[str, Tensor]"
) -> list[Change]:
    """A sentence for each thing that a perturbation changes in a scene, and its numbers before and after."""
    return [thing.change for thing in worded(scene, renderer, perturbation)]


def change_images(renderer: "Renderer", perturbation: "Mapping[str, Tensor]") -> "dict[str, Tensor]":
    """Images of what a perturbation changed, uint8 [h, w, 3], by file name; empty if the renderer declares none."""
    declared = RENDERERS[renderer.name]
    if declared.drawn is None:
        return {}
    with named(f"renderer {renderer.name!r}"):
        images: dict[str, Tensor] = resolve_name(declared.drawn)(renderer.exact(), perturbation)
        return images


def from_zero(size: PhysicalChange, name: str) -> ChangedValue:
    """The size of a change as a value of the thing `name` that was 0 before."""
    return ChangedValue(name=f"{name}, {size.measure}", unit=size.unit, before=0.0, after=size.value)


def number(value: float) -> str:
    """A size with two significant digits, e.g. "4.2", "12", "0.0031" or "2e-06"."""
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


def signed(value: float) -> str:
    """A signed number as `number` writes it, with a minus that is as wide as a plus: "+3.1", "−14", "0"."""
    return ("+" if value > 0 else "−" if value < 0 else "") + number(abs(value))


def listed(parts: Sequence[str]) -> str:
    """Words joined by commas and a last "and"."""
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last
