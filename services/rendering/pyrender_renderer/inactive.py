"""Coordinates that cannot change an image of the pyrender renderer, each with its proof.

Radiance is linear in the ambient light and in each energy, but for what glTF materials emit. So what two values of
one of these do, all values do: a light that adds nothing at energy 1 adds nothing at any. In a colour factor it is
linear or, for a glTF material that is part metal, quadratic: what three values do, all do. A light's position is not
linear, but the positions from which it reaches no pixel are a convex set: for every pixel the half-space behind its
surface. If they hold six points around a position, they hold all between.
"""

from collections.abc import Iterator, Mapping
from typing import Protocol

import torch
from torch import Tensor

from services.rendering.protocol import InactiveCoordinate

Values = Mapping[str, Tensor]

REACH = 0.1
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
    """The coordinates of which none alone changes the image at `parameters` {group: [...]}, moved by at most its
    group's `reach` up or down; energies, colours and the ambient light by any amount.
    """
    at = {group: parameters.get(group, value).double() for group, value in renderer.initial().items()}
    found = _lights(renderer, at, reach.get("illumination", REACH)) + _colors(renderer, at)
    for index in range(len(at["translation"])):
        if renderer.out_of_frame(at, index, reach.get("translation", REACH), turned=False):
            why = "the object is out of the frame, and would be were it moved by as much"
            found += [_inactive(renderer, "translation", 3 * index + axis, why) for axis in range(3)]
        if renderer.out_of_frame(at, index, 0.0, turned=True):
            why = "the object is out of the frame however it is turned"
            found += [_inactive(renderer, "rotation", 3 * index + axis, why) for axis in range(3)]
    return found


def _lights(renderer: Linear, at: Values, reach: float) -> list[InactiveCoordinate]:
    """The ambient light, and each other light where it is and around it, with one unit of it alone.

    The directions from which a directional light reaches no pixel are a convex cone, so that the same six points prove
    them. Those of a spot light, and its positions, are no convex set: they are idle only where it has no energy.
    """
    lights = at["illumination"]
    alone = torch.zeros_like(lights)
    alone[0] = 1.0
    found = []
    if _dark(renderer, at, alone):
        found.append(_inactive(renderer, "illumination", 0, "no object is in the image"))
    for kind, energy, others in _coordinates(renderer.names("illumination") or [], len(lights)):
        alone = torch.zeros_like(lights)
        alone[energy] = 1.0
        alone[others] = lights[others]
        behind = _dark(renderer, at, alone)
        if behind:
            found.append(_inactive(renderer, "illumination", energy, "the light is behind all that is seen"))
        if lights[energy] == 0:
            found += [_inactive(renderer, "illumination", place, "the light has no energy") for place in others]
        elif behind and kind != "spot" and all(_dark(renderer, at, moved) for moved in _around(alone, others, reach)):
            why = f"the light is behind all that is seen, and would be from anywhere within {reach:g}"
            found += [_inactive(renderer, "illumination", place, why) for place in others]
    return found


def _coordinates(names: list[str], count: int) -> Iterator[tuple[str, int, list[int]]]:
    """For each light of the group `illumination` its kind, the index of its energy, and of its other coordinates."""
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
    """Images with an object white, black and grey, where its colour has nothing to do if they are the same."""
    found = []
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
        found += [_inactive(renderer, "color", 3 * index + channel, why) for channel in range(3) if same[channel]]
    return found


def _image(renderer: Linear, at: Values, group: str, value: Tensor) -> Tensor:
    """Radiance [H, W, 3] with one group replaced. One at a time: that takes no shader but the one for one image."""
    return renderer.radiance({name: v[None] for name, v in {**at, group: value}.items()})[0, ..., :3]


def _inactive(renderer: Linear, group: str, index: int, why: str) -> InactiveCoordinate:
    names = renderer.names(group)
    return InactiveCoordinate(group, index, names[index] if names else f"{group} {index}", why)
