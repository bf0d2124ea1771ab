"""The torch renderer's image written down plainly, one tensor operation after another, for autograd to differentiate.

It shares the formulas of the material, the map and the display with the product, and none of its shading.
"""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from services.rendering.color import to_display
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.protocol import Parameters
from services.rendering.torch_renderer import dsbrdf
from services.rendering.torch_renderer.dsbrdf import MATERIAL_UNIT, colored_lobes
from services.rendering.torch_renderer.light import directions, illumination, solid_angles
from services.rendering.torch_renderer.table import to_vectors
from services.scenes.resolve import ResolvedScene


@dataclass
class PlainShading:
    """A scene of one object, all tensors of one dtype. P covered pixels, D directions."""

    pixels: Tensor
    coverage: Tensor
    base_color: Tensor
    colored: tuple[bool, ...]
    ground: Tensor
    towards: Tensor
    half: Tensor
    curves: Tensor
    power: Tensor

    @classmethod
    def of(cls, scene: ResolvedScene, dtype: torch.dtype) -> Self:
        """From a resolved scene."""
        gbuffer = rasterise(scene)
        to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]
        light = illumination(torch.as_tensor(scene.environment))
        rows, cols = light.intensity.shape
        towards = directions(rows, cols) @ to_camera
        half, theta_d = dsbrdf.half_vectors(towards, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))
        coverage = gbuffer.coverage.flatten()
        pixels = coverage.nonzero()[:, 0]
        return cls(
            pixels,
            coverage[pixels, None].to(dtype),
            gbuffer.base_color.reshape(-1, 3)[pixels].to(dtype),
            colored_lobes(scene.description.objects[0].material),
            torch.tensor(scene.description.ground, dtype=dtype),
            towards.to(dtype),
            half.to(dtype),
            (dsbrdf.basis(theta_d) / MATERIAL_UNIT).to(dtype),
            (light.exposure * light.chroma.reshape(-1, 3).T * solid_angles(rows, cols)).to(dtype),
        )

    def colours(self, parameters: Parameters, part: slice) -> Tensor:
        """Displayed colours [p, 3] of a slice of the covered pixels."""
        pixels = self.pixels[part]
        normals = to_vectors(parameters["normals"].reshape(-1, 2)[pixels])
        log_kappa, gamma = dsbrdf.lobes(parameters["material"][0], self.curves)  # [3, lobes, D]
        cosine = (normals @ self.towards.T).clamp_min(0.0)
        log_half = (normals @ self.half.T).clamp_min(dsbrdf.COSINE_FLOOR).log()
        light = self.power * parameters["illumination"].flatten()
        channels = []
        for c in range(3):
            sent = 0.0
            for kappa, exponent, colored in zip(log_kappa[c], gamma[c], self.colored, strict=True):
                shaded = (dsbrdf.reflectance(log_half, kappa, exponent) * cosine) @ light[c]
                sent = sent + shaded * (self.base_color[part, c] if colored else 1.0)
            channels.append(sent)
        shown = to_display(torch.stack(channels, dim=-1))
        coverage = self.coverage[part]
        return coverage * shown + (1 - coverage) * self.ground

    def gradients(
        self, initial: Parameters, groups: tuple[str, ...], weights: Tensor, chunk: int
    ) -> tuple[Tensor, Parameters]:
        """Colours [P, 3] and the gradients of (colours · weights).sum(), `chunk` pixels at a time.

        Each chunk goes forward and backward at once, which is the best case: in an attack the weights are only known
        after the whole image, and chunks would have to be computed twice.
        """
        leaves = {g: v.detach().clone().requires_grad_(g in groups) for g, v in initial.items()}
        colours = []
        for start in range(0, len(self.pixels), chunk):
            part = slice(start, start + chunk)
            shown = self.colours(leaves, part)
            (shown * weights[part]).sum().backward()
            colours.append(shown.detach())
        return torch.cat(colours), {g: leaves[g].grad for g in groups if leaves[g].grad is not None}
