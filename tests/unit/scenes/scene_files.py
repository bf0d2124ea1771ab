"""A small room as a glTF file, written byte by byte: what the tests of scene files read."""

from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gltf_models import sphere
from scene_attack_accuracy.stability.gltf_file import Writer

SHEAR = {"scale": [1.0, 3.0, 1.0]}
"""A parent's scale, in which a turned child is sheared."""
TILT = {"rotation": [0.0, 0.0, sin(0.4), cos(0.4)]}
FLOOR = {
    "POSITION": np.array([[-5.0, 0, -5], [5, 0, -5], [5, 0, 5], [-5, 0, 5]]),
    "indices": np.array([0, 2, 1, 0, 3, 2]),
}
LENS = {"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1}}


class Room:
    """A floor, two balls of which one is below a scaled table and sheared, a camera and two lights."""

    def __init__(self) -> None:
        self.writer = Writer()
        self.ball = self.writer.mesh(self.writer.primitive(sphere(0.5, 12), surface(0.8, 0.2, 0.2)))
        floor = self.writer.mesh(self.writer.primitive(FLOOR, surface(0.5, 0.5, 0.5)))
        self.node(name="Floor", mesh=floor)
        self.node(name="Ball", mesh=self.ball, translation=[-1, 0.5, 0])
        lamp = self.child(name="Lamp", mesh=self.ball, translation=[0, 0.4, 0], **TILT)
        self.node(name="Table", children=[lamp], translation=[1.5, 0, -1], **SHEAR)
        self.camera(name="Camera", translation=[0.5, 2, 6], rotation=[sin(-0.15), 0, 0, cos(-0.15)])
        self.light({"type": "point", "intensity": 800}, name="Bulb", translation=[2, 4, 2])
        self.light({"type": "directional", "intensity": 3}, name="Sun", rotation=[-0.5, 0, 0, 0.75**0.5])

    def node(self, **entry: Any) -> None:
        self.writer.root(**entry)

    def child(self, **entry: Any) -> int:
        return self.writer.add("nodes", entry)

    def camera(self, lens: dict[str, Any] = LENS, **entry: Any) -> None:
        self.node(camera=self.writer.add("cameras", lens), **entry)

    def light(self, light: dict[str, Any], **entry: Any) -> None:
        listed = self.writer.tree.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {"lights": []})[
            "lights"
        ]
        listed.append(light)
        self.writer.tree["extensionsRequired"] = ["KHR_lights_punctual"]  # as Blender writes it
        self.node(extensions={"KHR_lights_punctual": {"light": len(listed) - 1}}, **entry)

    def without(self, *names: str) -> "Room":
        """The room without these roots."""
        tree = self.writer.tree
        roots = tree["scenes"][0]["nodes"]
        tree["scenes"][0]["nodes"] = [k for k in roots if tree["nodes"][k]["name"] not in names]
        return self

    @property
    def glb(self) -> bytes:
        return self.writer.glb()


def surface(*color: float) -> dict[str, Any]:
    return {"pbrMetallicRoughness": {"baseColorFactor": [*color, 1], "metallicFactor": 0, "roughnessFactor": 0.7}}


def ball_points() -> NDArray[np.float64]:
    """The vertices of the balls in their own frame [V,3], as float32 has them."""
    points: NDArray[np.float64] = sphere(0.5, 12)["POSITION"].astype(np.float32).astype(np.float64)
    return points
