"""A scene with numbers for everything that an attack may move: poses, colours, camera and lights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from scene_attack.rendering.pyrender.declaration import PYRENDER, has_groups_of_pyrender
from scene_attack.rendering.pyrender.parameters import SceneParameters
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.runs.described import described
from scene_attack.scenes.description import DirectionalLight, Lights, PointLight, Scene, SpotLight
from scene_attack.scenes.mesh import Doubles
from scene_attack.scenes.resolve import ResolvedScene, far_plane
from scene_attack.scenes.view import camera_pose

AnyLight = TypeVar("AnyLight", PointLight, DirectionalLight, SpotLight)


@dataclass(frozen=True)
class LightValues:
    """One light. kind: "point", "directional" or "spot", glTF's words. energy: radiant intensity, or irradiance of a
    directional light, before exposure. position, direction: [3], world space; the direction is that in which the light
    travels. cone: inner and outer angle of a spot light, radians."""

    name: str
    kind: str
    energy: float
    position: Doubles
    direction: Doubles
    cone: tuple[float, float] = (0.0, pi / 4)

    @property
    def pose(self) -> Doubles:
        """World from light, float64 [4, 4]: glTF's lights shine along their −z."""
        pose = np.eye(4)
        pose[:3, 3] = self.position
        length = float(np.linalg.norm(self.direction))
        if self.kind != "point" and length > 0:
            back = -self.direction / length
            helper = np.eye(3)[int(np.abs(back).argmin())]
            right = np.cross(helper, back)
            right /= np.linalg.norm(right)
            pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(back, right), back
        return pose


@dataclass(frozen=True)
class SceneValues:
    """The values of a scene, before or after an attack.

    poses: world from mesh of all that is drawn, [things, 4, 4], what is fixed last. colors: linear factors on their
    base colours [things, 3]. camera: world from camera [4, 4]. ambient: mean radiance of the light from all around.
    description: the scene that has these values.
    """

    poses: Doubles
    colors: Doubles
    camera: Doubles
    ambient: float
    lights: tuple[LightValues, ...]
    description: Scene


def scene_values(scene: ResolvedScene, perturbation: Mapping[str, Tensor]) -> SceneValues:
    """The scene's own values plus a perturbation of the pyrender renderer's groups; other groups move none of these."""
    numbers = SceneParameters(scene)
    initial = numbers.initial()
    moved = {g: (initial[g] + change.double())[None] for g, change in perturbation.items() if g in initial}
    at = {group: value[0] for group, value in numbers.checked(moved).items()}
    poses = numbers.poses(at["translation"], at["rotation"])
    nothing = (0, 0, 0, 0)
    lit = numbers.lit(at["illumination"][None], at["color"][None], numbers.view(at["camera"]), poses, nothing)
    cones = [(spot.inner_angle, spot.outer_angle) for spot in scene.description.lights.spots]
    lights = [
        *(LightValues(f"point {i}", "point", row[0], row[1:], np.zeros(3)) for i, row in enumerate(lit.points[0])),
        *(
            LightValues(f"directional {i}", "directional", row[0], np.zeros(3), -row[1:])
            for i, row in enumerate(lit.directionals[0])
        ),
        *(LightValues(f"spot {i}", "spot", row[0], row[1:4], row[4:7], cones[i]) for i, row in enumerate(lit.spots[0])),
    ]
    update: dict[str, Any] = {"source": None}
    now = described(scene.description, perturbation)
    if moved:  # it keeps the far plane, on which the rounding of depths depends
        far = far_plane(scene.description, scene.view)
        update["camera"] = now.camera.model_copy(update={"far": far})
    if "illumination" in moved:
        update["lights"] = _lights(scene.description.lights, float(lit.ambients[0]), lights)
    return SceneValues(
        description=now.model_copy(update=update),
        poses=poses,
        colors=lit.colors[0],
        camera=camera_pose(*(float(x) for x in at["camera"])),
        ambient=float(lit.ambients[0]),
        lights=tuple(lights),
    )


def _lights(lights: Lights, ambient: float, values: Sequence[LightValues]) -> Lights:
    """The lights of a scene with the energies, positions and directions of `values`, which are in the same order."""
    rest = iter(values)

    def changed(light: AnyLight) -> AnyLight:
        new = next(rest)
        update: dict[str, Any] = {"energy": float(new.energy)}
        for name, vector in (("position", new.position), ("direction", new.direction)):
            if name in type(light).model_fields:
                update[name] = tuple(vector.tolist())
        return light.model_copy(update=update)

    kinds = {name: tuple(map(changed, getattr(lights, name))) for name in ("points", "directional", "spots")}
    return lights.model_copy(update=kinds | {"ambient": ambient})


def carried(renderer: str) -> tuple[str, ...]:
    """The groups of a renderer that change the scene itself, so that it differs before and after the attack: dents of
    the torch renderer are in its meshes' normals, and its shapes in their vertices.
    """
    if renderer == TORCH.name:
        return ("bump", *TORCH.moving_groups)
    return PYRENDER.group_names if has_groups_of_pyrender(renderer) else ()


def as_extras(light: LightValues) -> dict[str, Any]:
    """The energy of a light and its unit, which glTF's own fields do not say."""
    unit = "irradiance of a surface that faces it" if light.kind == "directional" else "radiant intensity"
    return {"energy": float(light.energy), "unit": unit}
