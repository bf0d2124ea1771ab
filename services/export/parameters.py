"""The attacked parameters by name, unit, and value before and after."""

from collections.abc import Mapping, Sequence

from pydantic import BaseModel, Field
from torch import Tensor

from services.rendering.declaration import RENDERERS
from services.rendering.protocol import Parameters
from services.rendering.pyrender_renderer.declaration import PYRENDER
from services.rendering.pyrender_renderer.parameters import ENERGY, IRRADIANCE, SceneParameters
from services.scenes.resolve import ResolvedScene


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
    numbers = SceneParameters(scene) if renderer == PYRENDER.name else None
    initial = {} if numbers is None else numbers.initial()
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


def _unit(group: str, name: str) -> tuple[float, str]:
    """The factor from the group's unit to the scene's, and the scene's unit."""
    word = name.rpartition(" ")[2]
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
