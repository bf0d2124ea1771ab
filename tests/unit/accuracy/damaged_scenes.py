"""Ways to break how a scene is meant: axes, units, maps and exposures."""

from dataclasses import replace

import torch

from services.accuracy.stability import networks, torch_light
from services.accuracy.stability.torch_shading import Shading
from services.rendering import color
from services.rendering.color import Canvas
from services.rendering.pyrender_renderer import parameters
from services.rendering.pyrender_renderer import renderer as pyrender_renderer
from services.rendering.torch_renderer import light, shader
from services.rendering.torch_renderer import renderer as torch_renderer
from services.scenes import environment, resolve, view
from services.scenes.reading import formats, gltf


def half_exposure(patch) -> None:
    """pyrender's exposure."""
    patch.setattr(pyrender_renderer, "EXPOSURE", pyrender_renderer.EXPOSURE / 2)


def half_white(patch) -> None:
    """The torch renderer's exposure."""
    patch.setattr(light, "WHITE", light.WHITE / 2)


def half_energy(patch) -> None:
    """Point lights are drawn with half their energy."""
    true = parameters.SceneParameters.lit

    def lit(self, illuminations, *given):
        halved = illuminations.copy()
        halved[:, 1::4] /= 2
        return true(self, halved, *given)

    patch.setattr(parameters.SceneParameters, "lit", lit)


def no_inverse_pi(patch) -> None:
    """The exposure takes a white surface's radiance for π times what it is."""
    true = torch_renderer.illumination
    patch.setattr(torch_renderer, "illumination", lambda map_: replace(m := true(map_), exposure=m.exposure / torch.pi))


def swapped_axes(patch) -> None:
    """x and z of point lights."""
    true = parameters.SceneParameters.lit

    def lit(self, illuminations, *given):
        swapped = illuminations.copy()
        swapped[:, 2::4], swapped[:, 4::4] = illuminations[:, 4::4], illuminations[:, 2::4]
        return true(self, swapped, *given)

    patch.setattr(parameters.SceneParameters, "lit", lit)


def maps(change):
    """Breaks the reading of map files."""

    def apply(patch) -> None:
        true = environment.from_image
        for module in (environment, torch_light):
            patch.setattr(module, "from_image", lambda image: change(true(image)))

    return apply


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


def squared_coverage(patch) -> None:
    """Of the torch renderer's images."""
    true = Canvas.image

    def image(canvas, radiance):
        return true(replace(canvas, coverage=canvas.coverage**2), radiance)

    patch.setattr(Canvas, "image", image)


def squared_coverage_over_ground(patch) -> None:
    """Of pyrender's images."""
    true = pyrender_renderer.over_ground

    def over_ground(radiance, *given):
        coverage = radiance[..., 3:]
        return true(torch.cat([radiance[..., :3] * coverage, coverage**2], dim=-1), *given)

    patch.setattr(pyrender_renderer, "over_ground", over_ground)


def other_gamma(patch) -> None:
    """The display curve with 2.2 for 2.4."""
    true = color.to_display

    def to_display(linear):
        shown = true(linear)
        return torch.where(
            shown > 0.04045, ((shown + 0.055) / 1.055).clamp_min(0) ** (2.4 / 2.2) * 1.055 - 0.055, shown
        )

    for module in (color, networks):
        patch.setattr(module, "to_display", to_display)


def other_inverse_gamma(patch) -> None:
    """The inverse display curve with 2.2 for 2.4."""
    true = networks.to_linear
    patch.setattr(networks, "to_linear", lambda shown: true(shown) ** (2.2 / 2.4))


def turned_back(patch) -> None:
    """Objects are turned the other way."""
    true = view.rotation_matrix
    patch.setattr(view, "rotation_matrix", lambda vectors: true(-vectors))


def mirrored_camera(patch) -> None:
    """The camera's right is its left."""
    true = resolve.camera_to_world

    def camera_to_world(given):
        pose = true(given)
        pose[:3, 0] *= -1
        return pose

    patch.setattr(resolve, "camera_to_world", camera_to_world)


def rolled_back_camera(patch) -> None:
    """The roll of an attacked camera turns it the other way."""
    true = parameters.MovingCamera.matrices
    patch.setattr(parameters.MovingCamera, "matrices", lambda self, given: true(self, given * (1, 1, 1, -1)))


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


def linear_tables(patch) -> None:
    """Tables between whose nodes nothing is curved: the mean of what is looked up around."""
    true = torch_light.look_up

    def look_up(table, angles):
        sides = [true(table, angles + torch.tensor(side, dtype=angles.dtype)) for side in ((0.02, 0.0), (-0.02, 0.0))]
        return (sides[0] + sides[1]) / 2

    patch.setattr(torch_light, "look_up", look_up)
