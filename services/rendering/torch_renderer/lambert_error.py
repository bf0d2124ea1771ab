"""Measures the error of taking a material to reflect the same share of the light in every direction."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from services.rendering.torch_renderer import dsbrdf, lambert
from services.rendering.torch_renderer.error_estimates import MAX_PERTURBATION, subset
from services.rendering.torch_renderer.plan_stages import HEADROOM
from services.rendering.torch_renderer.shader import Recipe, Shader, Sky, Surface, displayed_error

PIXELS = 256
"""Maximum number of pixels at which the error is measured."""


@torch.no_grad()
def alike_from_all_sides(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], limit: float
) -> float | None:
    """Returns the error of a displayed value that a constant reflectance costs a surface in shadow or a floor, if it is
    no more than `limit`; None if it is more, or the surface is no such surface.

    It is HEADROOM times the largest at a sample of pixels, with their own normals and, if `groups` has normals, with
    randomly perturbed ones.
    """
    if "material" in groups or not (surface.visibility is not None or surface.fixed_material):
        return None
    if lambert.albedo(surface.material) is None:
        return None
    sample = replace(subset(surface, PIXELS), visibility=None)
    if "normals" in groups:
        random = torch.Generator().manual_seed(3)
        step = 2 * torch.rand(sample.angles.shape, generator=random, dtype=torch.float64) - 1
        sample = replace(sample, angles=sample.angles + MAX_PERTURBATION["normals"] * step.to(sample.angles.device))
    lobes = surface.material.shape[1]
    every = torch.ones(dsbrdf.CHANNELS, lobes, dtype=torch.bool, device=sky.power.device)
    texels = torch.arange(sky.power.shape[1], device=sky.power.device)
    exact = Recipe(texels, False, every, ~every, "summed", moving=True, dtype=torch.float64)
    values = [
        Shader(recipe, sky, sample, illumination)(sample.angles, illumination, sample.material)
        for recipe in (replace(exact, lambert=True), exact)
    ]
    error = HEADROOM * displayed_error(values[0], values[1], sample.base_color)
    return error if error <= limit else None
