"""Splits objects into layers: the lobes whose light takes the mesh's colour, and those whose light keeps its own.

A dielectric's gloss is reflected at its surface and has the colour of the light; what enters the body and comes out
again, and what a conductor reflects, has the mesh's colour. So the radiance of an object is

    I = base_color · Σ_(coloured lobes) + Σ_(other lobes).

Each layer has a plan of its own. An object whose lobes are all coloured is a single layer.

The displayed error of an object is at most the sum of those of its layers, each taken alone: the display curve is
concave, so that light of another layer only flattens it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from torch import Tensor

from services.rendering.torch_renderer.presets import colored_lobes


@dataclass(frozen=True)
class Layer:
    """Lobes of one object. `owner` is the object's index, `words` say on plans which lobes it has, "" for all.

    `share` is the part of the tolerance that its error may take.
    """

    owner: int
    lobes: tuple[int, ...]
    colored: bool
    words: str = ""
    share: float = 1.0

    def material(self, of_object: Tensor) -> Tensor:
        """Returns the layer's coefficients [3, lobes, 2, 6] of an object's [3, LOBES, 2, 6]."""
        whole = len(self.lobes) == of_object.shape[1]
        return of_object if whole else of_object[:, list(self.lobes)]

    def base_color(self, of_object: Tensor) -> Tensor:
        """Returns the factor on the layer's radiance [P, 3], of an object's base colour [P, 3]."""
        return of_object if self.colored else of_object.new_ones(of_object.shape)


def layers(materials: Sequence[str]) -> list[tuple[Layer, ...]]:
    """Returns the layers of each object, whose presets are `materials`. Raises InvalidRequest as `preset` does."""
    return [tuple(_of(owner, name)) for owner, name in enumerate(materials)]


def _of(owner: int, name: str) -> Iterator[Layer]:
    colored = colored_lobes(name, f"scene.objects.{owner}.material")
    chosen = [tuple(lobe for lobe, own in enumerate(colored) if own is kind) for kind in (True, False)]
    words = ("of the body", "of the gloss") if all(chosen) else ("", "")
    share = 0.5 if all(chosen) else 1.0
    for kind, lobes, word in zip((True, False), chosen, words, strict=True):
        if lobes:
            yield Layer(owner, lobes, kind, word, share)
