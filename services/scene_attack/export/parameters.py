"""The attacked parameters by name, unit, and value before and after.

Of the torch renderer, normals are written as vectors, and light as a map: an OpenEXR image as other programs read it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel, Field
from torch import Tensor

from scene_attack.extras import extra
from scene_attack.rendering.declaration import RENDERERS, SHORTEST_WAVE
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.pyrender.declaration import has_groups_of_pyrender
from scene_attack.rendering.pyrender.parameters import ENERGY, IRRADIANCE, SceneParameters
from scene_attack.rendering.torch.lamp import Lamp
from scene_attack.rendering.torch.lattice import Lattice
from scene_attack.rendering.torch.light import illumination
from scene_attack.rendering.torch.moved import moved, places
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.shape import Shape
from scene_attack.rendering.torch.surfaces import visible_surfaces
from scene_attack.rendering.torch.table import to_vectors
from scene_attack.scenes.mesh import Bytes, Floats
from scene_attack.scenes.resolve import ResolvedScene


class Parameter(BaseModel):
    """One attacked coordinate, in the scene's own unit."""

    group: str
    name: str
    unit: str
    before: float
    after: float
    change: float


class LargeGroup(BaseModel):
    """A group of too many coordinates for a table."""

    group: str
    shape: list[int]
    axes: list[str]
    unit: str
    tensor: str = Field(description="where its change is")
    files: list[str] = Field(description="its values before and after")


class ParameterTable(BaseModel):
    """All attacked groups."""

    renderer: str
    parameters: list[Parameter]
    large: list[LargeGroup]


def parameter_table(
    scene: ResolvedScene, renderer: str, perturbation: Parameters, files: Mapping[str, Sequence[str]]
) -> ParameterTable:
    """The table. Groups without a name for each coordinate are listed with the `files` of their values, by group."""
    declaration = RENDERERS[renderer]
    numbers = SceneParameters(scene) if has_groups_of_pyrender(renderer) else None
    if numbers is not None:
        initial = numbers.initial()
    else:
        shares = {group: torch.zeros_like(change) for group, change in perturbation.items() if group in SHARES}
        initial = places(scene) | shares
    rows, large = [], []
    for group, change in perturbation.items():
        declared = declaration.group(group)
        if numbers is not None and group == "illumination":
            names: Sequence[str] | None = numbers.light_names()
        else:
            names = None if declared.labels is None else declared.labels(tuple(change.shape))
        if names is None or group not in initial:
            large.append(
                LargeGroup(
                    group=group,
                    shape=list(change.shape),
                    axes=list(declared.shape),
                    unit=declared.unit,
                    tensor=f"perturbation.safetensors: {group}",
                    files=list(files.get(group, ())),
                )
            )
            continue
        rows += [
            _row(group, name, old, new)
            for name, old, new in zip(names, initial[group].flatten(), change.double().flatten(), strict=True)
        ]
    return ParameterTable(renderer=renderer, parameters=rows, large=large)


def _row(group: str, name: str, old: Tensor, change: Tensor) -> Parameter:
    factor, unit = _unit(group, name)
    before, moved = factor * float(old), factor * float(change)
    return Parameter(group=group, name=name, unit=unit, before=before, after=before + moved, change=moved)


SHARES = ("dials", "lamp")
"""Groups of few numbers that are 0 at the start."""


def _unit(group: str, name: str) -> tuple[float, str]:
    """The factor from the group's unit to the scene's, and the scene's unit."""
    word = name.rpartition(" ")[2]
    if group in SHARES:
        return 1.0, "share of its natural range"
    if group == "color":
        return 1.0, "linear factor on the mesh's colour"
    if group == "rotation":
        return 1.0, "radians (rotation vector)"
    if group == "translation":
        return 1.0, "scene units"
    if group == "camera":
        return 1.0, "scene units" if word == "distance" else "radians"
    if word == "ambient":
        return 1.0, "radiance"
    if word == "energy":
        return (IRRADIANCE, "irradiance") if name.startswith("directional") else (ENERGY, "radiant intensity")
    return 1.0, "1 (of a unit vector)" if "direction" in name.split()[2:] else "scene units"


@dataclass(frozen=True)
class BeforeAfter:
    """An array before and after an attack."""

    before: Floats
    after: Floats


def light_maps(scene: ResolvedScene, perturbation: Parameters) -> BeforeAfter:
    """The radiance [rows, cols, 3] of the map's texels after the exposure, in linear display units, float32."""
    light = illumination(torch.as_tensor(scene.environment))

    def radiance(intensity: Tensor) -> Floats:
        values = light.exposure * light.chroma * intensity.clamp_min(0.0)
        return np.asarray(values.numpy(), np.float32)

    own = light.intensity[..., None]
    moved = own
    if "illumination" in perturbation:
        moved = moved + perturbation["illumination"].double()[..., None]
    if "illumination_rgb" in perturbation:
        moved = moved + perturbation["illumination_rgb"].double()
    if "lamp" in perturbation:
        intensity = light.intensity + perturbation.get("illumination", torch.zeros(())).double()
        moved = moved + Lamp.of(scene, light).added(perturbation["lamp"].double(), intensity)
    return BeforeAfter(radiance(own), radiance(moved))


def normal_maps(scene: ResolvedScene, perturbation: Parameters) -> BeforeAfter:
    """The unit normals [H, W, 3] that the pixels are shaded by, in the camera's frame (+x right, +y up, +z towards the
    viewer), float32; 0 where nothing is. Draws with OpenGL."""
    bent = Shape.of(perturbation["shape"]) if "shape" in perturbation else None
    there = scene if bent is None else replace(scene, meshes=bent.meshes(scene.meshes))
    start = places(scene)
    there = moved(there, {group: start[group] + change for group, change in perturbation.items() if group in start})
    wavelength = 2 / Lattice.under(perturbation["bump"]).cells if "bump" in perturbation else SHORTEST_WAVE
    renderer = TorchRenderer(there, groups=("bump",), tolerance="exact", wavelength=wavelength, bent=bent)
    after = renderer.initial()["normals"]
    is_surface = (after != 0).any(-1, keepdim=True)
    if "normals" in perturbation:
        after = after + perturbation["normals"].double()
    if "bump" in perturbation:
        shown = renderer.bump.shown
        angles = after.reshape(-1, 2).to(shown.pixels.device)
        turned = renderer.bump.turned(angles[shown.pixels], perturbation["bump"].double())
        nearest = shown.rank == 0
        after = angles.index_copy(0, shown.pixels[nearest], turned[nearest]).cpu().view_as(after)
    before = visible_surfaces(rasterise(scene), torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]).image
    return BeforeAfter(_vectors(before, (before != 0).any(-1, keepdim=True)), _vectors(after, is_surface))


def _vectors(angles: Tensor, is_surface: Tensor) -> Floats:
    """Unit vectors of angles [H, W, 2], 0 where there is no surface."""
    return np.asarray((to_vectors(angles.double()) * is_surface).numpy(), np.float32)


def as_colors(normals: Floats) -> Bytes:
    """Unit normals [H, W, 3] as an image: n / 2 + 1/2 of each axis, uint8; black where nothing is."""
    seen = (normals != 0).any(axis=-1, keepdims=True)
    return np.where(seen, np.rint((normals * 0.5 + 0.5) * 255), 0).astype(np.uint8)


def equirectangular(radiance: Floats) -> Floats:
    """A map [rows, cols, 3] in this project's directions as an equirectangular image; `environment.from_image` inverts.

    The image shows the sphere from inside: its middle column is +x, and columns further right show +z. So that its
    texels are the map's, each column is repeated four times where the number of columns is no multiple of four.
    """
    columns = radiance if radiance.shape[1] % 4 == 0 else np.repeat(radiance, 4, axis=1)
    return np.ascontiguousarray(np.roll(columns, columns.shape[1] // 4, axis=1)[:, ::-1])


def openexr() -> Any:
    """The package that writes maps. Raises MissingExtra("result") if it is not installed."""
    with extra("export", "the export of a scene that a map lights", "result"):
        import OpenEXR
    return OpenEXR


def write_exr(radiance: Floats, path: Path, comment: str) -> None:
    """Writes linear RGB radiance float32 [rows, cols, 3], in this project's directions, with 32 bits a value."""
    OpenEXR = openexr()
    image = np.asarray(equirectangular(radiance), np.float32)
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": comment}
    channels = {name: np.ascontiguousarray(image[..., k]) for k, name in enumerate("RGB")}
    with OpenEXR.File(head, channels) as file:
        file.write(str(path))
