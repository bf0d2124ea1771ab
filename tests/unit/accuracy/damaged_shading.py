"""Ways to break shading and light, each as a function of pytest's monkeypatch."""

from dataclasses import replace

import numpy as np
import torch

from services.accuracy.stability import torch_light, torch_shading
from services.rendering.color import Canvas
from services.rendering.torch_renderer import dsbrdf, shader
from services.rendering.torch_renderer import renderer as torch_renderer
from services.rendering.torch_renderer.dsbrdf import COSINE_FLOOR
from services.scenes import environment


def naive_lobes(patch) -> None:
    """exp(κ cos^γ) − 1 as it is written, in the dtype given: overflows, and cancels where κ is small."""

    def radiance(at, light, lobes, directions):
        half = (at @ directions.half[:3]).clamp_min(COSINE_FLOOR)[None]
        rho = lobes.base[:, None] + lobes.tilt[:, None] * half.log()
        for k in range(lobes.log_kappa.shape[1]):
            rho = rho + torch.exp(lobes.log_kappa[:, k, None].exp() * half ** lobes.gamma[:, k, None]) - 1
        shaded = rho * (at @ directions.towards).clamp_min(0)
        return torch.einsum("cnd,cd->nc", shaded.expand(3, -1, -1), light)

    patch.setattr(shader, "radiance", radiance)


def other_lobes(patch, kappa: float = 1.0, gamma: float = 1.0) -> None:
    """Lobes with other κ and γ than asked for."""
    true = shader.radiance

    def radiance(at, light, lobes, directions):
        changed = replace(lobes, log_kappa=lobes.log_kappa + np.log(kappa), gamma=lobes.gamma * gamma)
        return true(at, light, changed, directions)

    patch.setattr(shader, "radiance", radiance)


def blunter_lobes(patch) -> None:
    other_lobes(patch, gamma=0.8)


def brighter_lobes(patch) -> None:
    other_lobes(patch, kappa=1.05)


def wrong_gradients(patch) -> None:
    """Gradients a tenth too long, images as they are."""

    class Longer(torch.autograd.Function):
        @staticmethod
        def forward(_, value):
            return value.clone()

        @staticmethod
        def backward(_, gradient):
            return 1.1 * gradient

    true = Canvas.image
    patch.setattr(Canvas, "image", lambda canvas, radiance: Longer.apply(true(canvas, radiance)))


def turned_normals(patch) -> None:
    """Angles read with a polar angle of 0.02 too much."""
    true = shader.to_vectors
    patch.setattr(shader, "to_vectors", lambda angles: true(angles + torch.tensor([0.0, 0.02], dtype=angles.dtype)))


def blunt_poles(patch) -> None:
    """Poles where the azimuth still means something."""
    true = shader.to_vectors
    patch.setattr(shader, "to_vectors", lambda angles: true(angles) + 0.02 * angles[..., :1].sin())


def angles_by_arc_cosine(patch) -> None:
    """The textbook's polar angle, which loses half of the digits beside a pole."""

    def to_angles(vectors):
        x, y, z = torch.nn.functional.normalize(vectors, dim=-1).unbind(-1)
        return torch.stack((torch.atan2(x, z), torch.acos(y)), dim=-1)

    patch.setattr(torch_shading, "to_angles", to_angles)


def brighter_light(patch, factor: float = 1.05) -> None:
    """An exposure that is 5 % too much."""
    true = torch_renderer.illumination

    def illumination(map_):
        found = true(map_)
        return replace(found, exposure=factor * found.exposure)

    patch.setattr(torch_renderer, "illumination", illumination)


def colored_gloss(patch) -> None:
    """Gloss multiplied by the mesh's colour whatever the material."""
    patch.setattr(dsbrdf, "colored_lobes", lambda *_: (True, True, True))


def colorless_metal(patch) -> None:
    """Gloss that keeps the light's colour whatever the material."""
    patch.setattr(dsbrdf, "colored_lobes", lambda *_: (True, False, False))


def swapped_light(patch) -> None:
    """Light whose red and blue are exchanged where each channel has its own."""
    true = shader.Shader.__call__

    def call(shader_, angles, light, material):
        return true(shader_, angles, light.flip(0) if light.dim() == 2 else light, material)

    patch.setattr(shader.Shader, "__call__", call)


def colorless_light(patch) -> None:
    """Light in one channel where each should have its own."""
    true = shader.Shader.__call__

    def call(shader_, angles, light, material):
        return true(shader_, angles, light.mean(0) if light.dim() == 2 else light, material)

    patch.setattr(shader.Shader, "__call__", call)


def far_too_bright_light(patch) -> None:
    brighter_light(patch, 10.0)


def unguarded_light(patch) -> None:
    """A map taken apart by dividing by whatever its mean is, float32 throughout."""

    def illumination(map_):
        luminance = map_.float() @ torch.tensor([0.2126, 0.7152, 0.0722])
        found = torch_renderer_illumination(torch.ones(4, 8, 3))
        return replace(found, intensity=luminance / luminance.mean(), chroma=map_.float() / luminance[..., None])

    patch.setattr(torch_renderer, "illumination", illumination)


torch_renderer_illumination = torch_renderer.illumination


def unscaled_light(patch) -> None:
    """An exposure that does not look at the map."""
    true = torch_renderer.illumination
    patch.setattr(
        torch_renderer,
        "illumination",
        lambda map_: replace(true(map_), intensity=map_.double()[..., 0], exposure=1.0),
    )


def accepted_texels(patch) -> None:
    """What is not a number becomes 0, and what is negative stays."""
    clean = lambda pixels: environment.from_image(np.nan_to_num(pixels, nan=0.0, posinf=0.0, neginf=0.0))  # noqa: E731
    patch.setattr(torch_light, "radiance_of", clean)


def means_of_texels(patch) -> None:
    """Averages that count texels, not solid angles; and lose a thousandth."""

    def average(radiance, rows, cols, rotation=0.0):
        height, width = max(1, radiance.shape[0] // rows), max(1, radiance.shape[1] // cols)
        cut = radiance[: rows * height, : cols * width]
        if cut.shape[:2] != (rows * height, cols * width):
            return 0.999 * environment.average(radiance, rows, cols, rotation)
        return cut.reshape(rows, height, cols, width, 3).mean(axis=(1, 3))

    patch.setattr(torch_light, "average", average)
