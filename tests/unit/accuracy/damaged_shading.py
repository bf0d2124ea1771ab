"""Ways to break shading and light, and how a scene is meant: axes, units, maps and exposures."""

from dataclasses import replace

import numpy as np
import torch

from scene_attack.rendering import color, pose
from scene_attack.rendering.color import Canvas
from scene_attack.rendering.pyrender import parameters
from scene_attack.rendering.pyrender import renderer as pyrender_renderer
from scene_attack.rendering.torch import dsbrdf, light, shader
from scene_attack.rendering.torch import renderer as torch_renderer
from scene_attack.rendering.torch.dsbrdf import COSINE_FLOOR
from scene_attack.scenes import environment, resolve, view
from scene_attack.scenes.reading import formats, gltf
from scene_attack_accuracy.stability import networks, torch_light, torch_shading
from scene_attack_accuracy.stability.torch_shading import Shading
from tests.unit.accuracy.damage import breaks


@breaks("radiance", shader)
def naive_lobes(_true, at, light, lobes, directions, *_):
    """exp(κ cos^γ) − 1 as it is written, in the dtype given: overflows, and cancels where κ is small."""
    half = (at @ directions.half[:3]).clamp_min(COSINE_FLOOR)[None]
    rho = lobes.base[:, None] + lobes.tilt[:, None] * half.log()
    for k in range(lobes.log_kappa.shape[1]):
        rho = rho + torch.exp(lobes.log_kappa[:, k, None].exp() * half ** lobes.gamma[:, k, None]) - 1
    shaded = rho * (at @ directions.towards).clamp_min(0)
    return torch.einsum("cnd,cd->nc", shaded.expand(3, -1, -1), light)


def other_lobes(patch, kappa: float = 1.0, gamma: float = 1.0) -> None:
    """Lobes with other κ and γ than asked for."""
    true = shader.radiance

    def radiance(at, light, lobes, *given):
        changed = replace(lobes, log_kappa=lobes.log_kappa + np.log(kappa), gamma=lobes.gamma * gamma)
        return true(at, light, changed, *given)

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


@breaks("to_angles", torch_shading)
def angles_by_arc_cosine(_, vectors):
    """The textbook's polar angle, which loses half of the digits beside a pole."""
    x, y, z = torch.nn.functional.normalize(vectors, dim=-1).unbind(-1)
    return torch.stack((torch.atan2(x, z), torch.acos(y)), dim=-1)


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


@breaks("__call__", shader.Shader)
def swapped_light(true, shader_, angles, light, *others):
    """Light whose red and blue are exchanged where each channel has its own."""
    return true(shader_, angles, light.flip(0) if light.dim() == 2 else light, *others)


@breaks("__call__", shader.Shader)
def colorless_light(true, shader_, angles, light, *others):
    """Light in one channel where each should have its own."""
    return true(shader_, angles, light.mean(0) if light.dim() == 2 else light, *others)


def far_too_bright_light(patch) -> None:
    brighter_light(patch, 10.0)


@breaks("illumination", torch_renderer)
def unguarded_light(_, map_):
    """A map taken apart by dividing by whatever its mean is, float32 throughout."""
    luminance = map_.float() @ torch.tensor([0.2126, 0.7152, 0.0722])
    found = unbroken_illumination(torch.ones(4, 8, 3))
    return replace(found, intensity=luminance / luminance.mean(), chroma=map_.float() / luminance[..., None])


unbroken_illumination = torch_renderer.illumination


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


@breaks("average", torch_light)
def means_of_texels(_, radiance, rows, cols, rotation=0.0):
    """Averages that count texels, not solid angles; and lose a thousandth."""
    height, width = max(1, radiance.shape[0] // rows), max(1, radiance.shape[1] // cols)
    cut = radiance[: rows * height, : cols * width]
    if cut.shape[:2] != (rows * height, cols * width):
        return 0.999 * environment.average(radiance, rows, cols, rotation)
    return cut.reshape(rows, height, cols, width, 3).mean(axis=(1, 3))


def half_exposure(patch) -> None:
    """pyrender's exposure."""
    patch.setattr(pyrender_renderer, "EXPOSURE", pyrender_renderer.EXPOSURE / 2)


def half_white(patch) -> None:
    """The torch renderer's exposure."""
    patch.setattr(light, "WHITE", light.WHITE / 2)


@breaks("lit", parameters.SceneParameters)
def half_energy(true, self, illuminations, *given):
    """Point lights are drawn with half their energy."""
    halved = illuminations.copy()
    halved[:, 1::4] /= 2
    return true(self, halved, *given)


def no_inverse_pi(patch) -> None:
    """The exposure takes a white surface's radiance for π times what it is."""
    true = torch_renderer.illumination
    patch.setattr(torch_renderer, "illumination", lambda map_: replace(m := true(map_), exposure=m.exposure / torch.pi))


@breaks("lit", parameters.SceneParameters)
def swapped_axes(true, self, illuminations, *given):
    """x and z of point lights."""
    swapped = illuminations.copy()
    swapped[:, 2::4], swapped[:, 4::4] = illuminations[:, 4::4], illuminations[:, 2::4]
    return true(self, swapped, *given)


def maps(change):
    """Breaks the reading of map files."""
    return breaks("from_image", environment, torch_light)(lambda true, image: change(true(image)))


mirrored_maps = maps(lambda radiance: radiance[:, ::-1])
maps_upside_down = maps(lambda radiance: radiance[::-1])
maps_turned = maps(lambda radiance: torch.from_numpy(radiance.copy()).roll(8, 1).numpy())


def map_turned_back(patch) -> None:
    """Maps turn the other way."""
    true = torch_light.average
    patch.setattr(torch_light, "average", lambda map_, rows, cols, turn=0.0: true(map_, rows, cols, -turn))


def directions_swapped(patch) -> None:
    """x and z of the torch renderer's light."""
    true = torch_renderer.directions
    for module in (torch_renderer, light):
        patch.setattr(module, "directions", lambda rows, cols: true(rows, cols).flip(-1))


def no_solid_angles(patch) -> None:
    """Every texel counts alike."""
    alike = lambda rows, cols: torch.full((rows * cols,), 4 * torch.pi / rows / cols, dtype=torch.float64)  # noqa: E731
    for module in (torch_renderer, light):
        patch.setattr(module, "solid_angles", alike)


def channels_swapped(patch) -> None:
    """Red for blue, in pyrender's images."""
    true = pyrender_renderer.PyrenderRenderer.render
    patch.setattr(pyrender_renderer.PyrenderRenderer, "render", lambda self, given: true(self, given).flip(-1))


@breaks("image", Canvas)
def squared_coverage(true, canvas, radiance):
    """Of the torch renderer's images."""
    return true(replace(canvas, coverage=canvas.coverage**2), radiance)


@breaks("over_ground", pyrender_renderer)
def squared_coverage_over_ground(true, radiance, *given):
    """Of pyrender's images."""
    coverage = radiance[..., 3:]
    return true(torch.cat([radiance[..., :3] * coverage, coverage**2], dim=-1), *given)


@breaks("to_display", color, networks)
def other_gamma(true, linear):
    """The display curve with 2.2 for 2.4."""
    shown = true(linear)
    return torch.where(shown > 0.04045, ((shown + 0.055) / 1.055).clamp_min(0) ** (2.4 / 2.2) * 1.055 - 0.055, shown)


def other_inverse_gamma(patch) -> None:
    """The inverse display curve with 2.2 for 2.4."""
    true = networks.to_linear
    patch.setattr(networks, "to_linear", lambda shown: true(shown) ** (2.2 / 2.4))


def turned_back(patch) -> None:
    """Objects are turned the other way."""
    true = view.rotation_matrix
    patch.setattr(view, "rotation_matrix", lambda vectors: true(-vectors))


@breaks("camera_to_world", resolve)
def mirrored_camera(true, given):
    """The camera's right is its left."""
    turned = true(given)
    turned[:3, 0] *= -1
    return turned


def rolled_back_camera(patch) -> None:
    """The roll of an attacked camera turns it the other way."""
    true = pose.MovingCamera.matrices
    patch.setattr(pose.MovingCamera, "matrices", lambda self, given: true(self, given * (1, 1, 1, -1)))


def files_upside_down(patch) -> None:
    """v of glTF files is taken to run up."""
    true = gltf.read_gltf

    def upside_down(*given):
        up = torch.tensor([0.0, 1.0]).numpy()
        return tuple(replace(part, uv=abs(up - part.uv)) for part in true(*given))

    for module in (gltf, formats):
        patch.setattr(module, "read_gltf", upside_down, raising=False)


def unchecked_tables(patch) -> None:
    """Once a plan is made, what is looked up is 1 % too bright, and the pixels summed beside it are not compared."""
    plan, true = Shading.of, shader.look_up

    def of(*given):
        made = plan(*given)
        patch.setattr(shader, "look_up", lambda *at: 1.01 * true(*at))
        patch.setattr(shader, "displayed_error", lambda *_: 0.0)
        return made

    patch.setattr(Shading, "of", of)


@breaks("look_up", torch_light)
def linear_tables(true, table, angles):
    """Tables between whose nodes nothing is curved: the mean of what is looked up around."""
    sides = [true(table, angles + torch.tensor(side, dtype=angles.dtype)) for side in ((0.02, 0.0), (-0.02, 0.0))]
    return (sides[0] + sides[1]) / 2
