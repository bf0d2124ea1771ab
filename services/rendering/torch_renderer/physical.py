"""Perturbations of the torch renderer's groups in degrees and percent."""

from collections.abc import Iterator, Mapping
from math import degrees

import torch
from torch import Tensor

from services.rendering.physical_change import PhysicalChange
from services.rendering.protocol import Renderer
from services.rendering.torch_renderer.normals import to_vectors
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN, MATERIAL_UNIT
from services.scenes.resolve import ResolvedScene

CHANNELS = ("red", "green", "blue")


def changes(
    scene: ResolvedScene,  # noqa: ARG001 - the declaration's signature
    renderer: Renderer,
    perturbation: Mapping[str, Tensor],
) -> list[PhysicalChange]:
    """A perturbation of the renderer's initial values, by group."""
    found: list[PhysicalChange] = []
    for group, change in perturbation.items():
        if group == "normals":
            initial = renderer.initial()[group]
            covered = (initial != 0).any(dim=-1)  # the angles of uncovered pixels are 0
            found += normal_changes(initial, change, covered)
        elif group == "illumination":
            found += map_changes(group, "map", change)
        elif group == "illumination_rgb":
            for channel, values in zip(CHANNELS, change.unbind(-1), strict=True):
                found += map_changes(group, f"map, {channel}", values)
        elif group == "material":
            found += material_changes(change)
    return found


def normal_changes(initial: Tensor, change: Tensor, covered: Tensor) -> Iterator[PhysicalChange]:
    """Angles by which the normals turn, given angles [H, W, 2] and the mask of covered pixels, bool [H, W]."""
    before, after = to_vectors(initial[covered].double()), to_vectors((initial + change)[covered].double())
    angles = 2 * ((after - before).norm(dim=-1) / 2).clamp(max=1).asin()
    for measure, value in (
        ("root mean square of the angles", float(angles.square().mean().sqrt())),
        ("largest angle", float(angles.max())),
    ):
        yield PhysicalChange(group="normals", subject="surface", measure=measure, value=degrees(value), unit="degrees")


def map_changes(group: str, subject: str, change: Tensor) -> Iterator[PhysicalChange]:
    """Changes of the environment map's texels [rows, cols] in one channel or all, in percent of the map's mean
    intensity."""
    percent = 100 * change.double() / ILLUMINATION_MEAN
    for measure, value in (
        ("root mean square of the texels", percent.square().mean().sqrt()),
        ("largest texel", percent.flatten()[percent.abs().argmax()]),
    ):
        yield PhysicalChange(
            group=group, subject=subject, measure=measure, value=float(value), unit="% of its mean intensity"
        )


def material_changes(change: Tensor) -> Iterator[PhysicalChange]:
    """Largest relative changes of the lobes' κ and γ by object, given coefficients [objects, 3, 3, 2, 6].

    A Bernstein polynomial moves by no more than its coefficients, and they are logarithms.
    """
    for index, thing in enumerate(change.double()):
        for word, values in zip(("κ", "γ"), torch.unbind(thing, dim=-2), strict=True):
            # A third (−67 %) is further off than double (+100 %) as a logarithm, and less in percent.
            percent = 100 * torch.expm1(values.flatten() / MATERIAL_UNIT)
            yield PhysicalChange(
                group="material",
                subject=f"object {index} {word}",
                measure="largest change",
                value=float(percent[percent.abs().argmax()]),
                unit="%",
            )
