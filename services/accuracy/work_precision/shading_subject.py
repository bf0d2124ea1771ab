"""One object of a real scene as shading takes it: its pixels, the light, and a function of the image to derive."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from services.accuracy.placing import placed
from services.attacks.seeds import generator
from services.rendering.color import to_display
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer import lookup_table
from services.rendering.torch_renderer.environment_light import illumination
from services.rendering.torch_renderer.error_estimates import MAX_PERTURBATION
from services.rendering.torch_renderer.normals import to_angles
from services.rendering.torch_renderer.presets import preset
from services.rendering.torch_renderer.renderer import sky_of
from services.rendering.torch_renderer.shader import Shader, Sky, Surface
from services.rendering.torch_renderer.units import MATERIAL_UNIT
from services.scenes.resolve import ResolvedScene

GROUPS = ("normals", "illumination", "material")
FAR = 0.1
"""Part of an attack's reach that the scene is moved by, coordinate by coordinate with random signs."""
COARSE = 14
"""Squares a side of the random numbers that an image's weights are smoothed from."""


@dataclass(frozen=True)
class Subject:
    """A scene of one object, taken apart.

    scene: as it was resolved; pixels [P]: flat indices of its covered pixels; surface: of these; sky and intensity [D]:
    its light; moved: values of the three groups some way into an attack, float64; coverage [P, 1]; weights [P, 3]:
    those of the image in the function whose gradient is taken.
    """

    mesh: str
    material: str
    size: tuple[int, int]
    map: tuple[int, int]
    scene: ResolvedScene
    pixels: Tensor
    surface: Surface
    sky: Sky
    intensity: Tensor
    moved: dict[str, Tensor]
    coverage: Tensor
    weights: Tensor

    def image(self, shader: Shader, values: dict[str, Tensor]) -> Tensor:
        """Displayed values [P, 3] of the covered pixels, without the ground's share, in the recipe's dtype."""
        radiance = shader(values["normals"], values["illumination"], values["material"])
        shown = to_display(radiance * self.surface.base_color.to(radiance.dtype))
        return self.coverage.to(radiance.dtype) * shown

    def only(self, some: Tensor) -> "Subject":
        """The same with the covered pixels at the places `some` alone."""
        surface = replace(self.surface, angles=self.surface.angles[some], base_color=self.surface.base_color[some])
        return replace(
            self,
            pixels=self.pixels[some],
            surface=surface,
            moved=self.moved | {"normals": self.moved["normals"][some]},
            coverage=self.coverage[some],
            weights=self.weights[some],
        )

    def value(self, image: Tensor) -> Tensor:
        """⟨weights, image⟩, summed in float64."""
        return (image.double() * self.weights).sum()


def subject(mesh: str, material: str, size: tuple[int, int], texels: tuple[int, int]) -> Subject:
    """A furniture model of one material under the studio map of so many texels. Raises as `resolve` does."""
    scene = placed(
        mesh,
        size=size,
        thing={"material": material},
        lights={"environment": {"map": "studio", "size": texels}},
    )
    gbuffer = rasterise(scene)
    to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]
    angles = to_angles(gbuffer.normals.double() @ to_camera).float().double().reshape(-1, 2)
    covered = gbuffer.coverage.flatten().nonzero()[:, 0]
    pixels = covered[torch.argsort(lookup_table.normal_sort_keys(angles[covered]), stable=True)]
    sky, intensity = light_of(scene)
    values = {
        "normals": angles[pixels],
        "illumination": intensity,
        "material": (preset(material) * MATERIAL_UNIT).float().double(),
    }
    surface = Surface(
        "object 0", values["normals"], gbuffer.base_color.reshape(-1, 3)[pixels].double(), values["material"]
    )
    coverage = gbuffer.coverage.flatten()[pixels, None].double()
    weights = smooth_weights(size).reshape(-1, 3)[pixels]
    return Subject(
        mesh, material, size, texels, scene, pixels, surface, sky, intensity, moved(values), coverage, weights
    )


def light_of(scene: ResolvedScene) -> tuple[Sky, Tensor]:
    """The sky of a scene's map as its camera sees it, and the map's intensities [D], rounded to float32."""
    to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]
    light = illumination(torch.as_tensor(scene.environment))
    return sky_of(light, to_camera), light.intensity.flatten().float().double()


def moved(values: dict[str, Tensor]) -> dict[str, Tensor]:
    """The values with every coordinate moved by FAR of its reach, up or down at random."""
    found = {}
    for group, value in values.items():
        random = generator(0, "work-precision", group)
        signs = (torch.rand(value.shape, generator=random, dtype=torch.float64) - 0.5).sign()
        found[group] = value + FAR * MAX_PERTURBATION[group] * signs
    found["illumination"].clamp_(min=0.0)
    return {group: value.float().double() for group, value in found.items()}


def smooth_weights(size: tuple[int, int]) -> Tensor:
    """Weights [H, W, 3] float64 of an image's values: random, smooth over an image's COARSEth, mean square 1.

    A network's gradient is of that kind; white noise would make every derivative a matter of single pixels.
    """
    random = torch.randn(1, 3, COARSE, COARSE, generator=generator(0, "work-precision", "weights"), dtype=torch.float64)
    smooth = interpolate(random, size, mode="bicubic")[0].permute(1, 2, 0)
    return smooth / smooth.square().mean().sqrt()
