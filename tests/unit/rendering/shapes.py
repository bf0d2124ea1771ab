"""Meshes with known geometry, scenes around them, and what a camera sees of a plane or sphere in closed form."""

import os
import subprocess
import sys
from math import cos, pi, sin, tan
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scene_attack.scenes.description import Camera, Lights, Scene, SceneObject
from scene_attack.scenes.mesh import Mesh, Part
from scene_attack.scenes.resolve import ResolvedScene

PLATFORMS = ("egl", "osmesa")
NEAR, FAR = 0.05, 50.0


def part(vertices, faces, normals, color=(1, 1, 1, 1), uv=None, texture=None) -> Part:
    f32 = np.float32
    uv = None if uv is None else np.array(uv, f32)
    color = np.array(color, f32)
    return Part(np.array(vertices, f32), np.array(normals, f32), np.array(faces, np.int32), uv, color, texture)


def mesh(*parts: Part) -> Mesh:
    return Mesh(tuple(parts), "0" * 64, None)


def quad(half_width=0.5, half_height=None, centre=(0, 0, 0), color=(1, 1, 1, 1), texture=None, uv=None) -> Part:
    """A rectangle in the plane z = centre z, facing +z, uv (0,0) at its lower left."""
    w, h = half_width, half_width if half_height is None else half_height
    corners = np.array([[-w, -h, 0], [w, -h, 0], [w, h, 0], [-w, h, 0]]) + centre
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]] if uv is None else uv
    return part(corners, [[0, 1, 2], [0, 2, 3]], [[0, 0, 1]] * 4, color, uv, texture)


def disk(radius=0.5, sides=512, color=(1, 1, 1, 1)) -> Part:
    turn = np.arange(sides) * 2 * pi / sides
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * radius
    faces = [[0, 1 + i, 1 + (i + 1) % sides] for i in range(sides)]
    return part(np.vstack([np.zeros(3), rim]), faces, [[0, 0, 1]] * (sides + 1), color)


def sphere(radius=0.5, rings=96, color=(1, 1, 1, 1)) -> Part:
    theta, phi = np.meshgrid(np.linspace(0, pi, rings + 1), np.linspace(0, 2 * pi, 2 * rings + 1), indexing="ij")
    normals = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1).reshape(-1, 3)
    first = (np.arange(rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).reshape(-1, 1)
    below = first + 2 * rings + 1
    faces = np.vstack([np.hstack([first, below, first + 1]), np.hstack([first + 1, below, below + 1])])
    return part(normals * radius, faces, normals, color)


def six_parts() -> Mesh:
    """A cube of six textured squares."""
    rng = np.random.default_rng(0)
    sides = []
    for turn in [Rotation.from_euler("y", k * pi / 2) for k in range(4)] + [
        Rotation.from_euler("x", s * pi / 2) for s in (1, -1)
    ]:
        side = quad(0.3, centre=(0, 0, 0.3), texture=rng.integers(0, 255, (16, 16, 4), dtype=np.uint8) | 128)
        turned = part(
            turn.apply(side.vertices), side.faces, turn.apply(side.normals), side.color, side.uv, side.texture
        )
        sides.append(turned)
    return mesh(*sides)


def scene(size=(96, 128), objects=1, lights: Lights | None = None, **camera: Any) -> Scene:
    return Scene(
        camera=Camera(**({"size": size, "azimuth": 0.0, "elevation": 0.0} | camera)),
        objects=tuple(SceneObject(mesh="primitive/sphere") for _ in range(objects)),
        lights=lights or Lights(),
    )


def placed(description: Scene, *meshes: Mesh) -> ResolvedScene:
    """The scene with these meshes for its objects; matrices from the conventions, independently of `resolve`."""
    camera = description.camera
    back, right = camera_axes(camera)
    view = np.eye(4)
    view[:3, 0], view[:3, 1], view[:3, 2] = right, np.cross(back, right), back
    view[:3, 3] = camera.distance * back
    height, width = camera.size
    f = 1 / tan(camera.field_of_view / 2)
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1], projection[3, 2] = f * height / width, f, -1
    projection[2, 2], projection[2, 3] = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
    models = []
    for thing in description.objects:
        model = np.eye(4)
        model[:3, :3] = thing.scale * Rotation.from_rotvec(thing.rotation).as_matrix()
        model[:3, 3] = thing.translation
        models.append(model)
    return ResolvedScene(
        description=description,
        meshes=tuple(meshes),
        models=tuple(models),
        view=view,
        projection=projection,
        environment=np.ones((16, 32, 3), np.float32),
        map_credit=None,
        sha256="0" * 64,
    )


def camera_axes(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors backwards (from the origin to the camera) and to the right."""
    a, e = camera.azimuth, camera.elevation
    return np.array([sin(a) * cos(e), sin(e), cos(a) * cos(e)]), np.array([cos(a), 0.0, -sin(a)])


def rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Camera position [3] and, through each pixel's middle, a direction [H, W, 3] that is 1 long along the view."""
    back, right = camera_axes(camera)
    height, width = camera.size
    y = 1 - (2 * np.arange(height) + 1) / height
    x = ((2 * np.arange(width) + 1) / width - 1) * width / height
    x, y = np.meshgrid(x, y)
    t = tan(camera.field_of_view / 2)
    return camera.distance * back, t * (x[..., None] * right + y[..., None] * np.cross(back, right)) - back


def on_platform(platform: str, code: str, *arguments: str) -> str:
    """The output of Python code run in a process of its own on a GL platform; it may import this module."""
    environment = {k: v for k, v in os.environ.items() if k != "EGL_DEVICE_ID"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[3])
    environment["PYOPENGL_PLATFORM"] = platform
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
