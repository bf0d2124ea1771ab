"""Scenes that are hard to rasterise, poses around their initial ones, and the error against OpenGL's images."""

import numpy as np
import torch

from scene_attack.rendering.pyrender.planner import ImageError, both_sides, image_error
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import GROUND, Lights, PointLight
from scene_attack.scenes.mesh import Part
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering.shapes import part, sphere

LIGHTS = Lights(
    ambient=0.4, points=(PointLight(), PointLight(energy=9.0, position=(-1, 0.4, 1)), PointLight(position=(0, 0, 0.1)))
)
GLASS = (0.3, 0.5, 1.0, 0.35)


def soup(seed: int, faces: int, size: float, color=(1, 1, 1, 1), depth: float = 0.5, texture=None) -> Part:
    """Triangles at random positions and orientations with random normals, the last one with zero normals.

    A tenth of them occurs twice, and half of them are slivers.
    """
    random = np.random.default_rng(seed)
    middles = random.uniform(-0.45, 0.45, (faces, 1, 3)) * (1, 1, depth)
    corners = middles + size * random.normal(size=(faces, 3, 3))
    thin = random.random(faces) < 0.5
    corners[thin, 2] = corners[thin, 0] + 0.9 * (corners[thin, 1] - corners[thin, 0]) + 0.002 * random.normal(size=3)
    corners[: faces // 10] = corners[-(faces // 10) :]
    normals = random.normal(size=(3 * faces, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[-3:] = 0
    uv = None if texture is None else random.normal(size=(3 * faces, 2)) * 10.0 ** random.uniform(-2, 1)
    return part(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3), normals, color, uv, texture)


def threads(seed: int, faces: int) -> Part:
    """Triangles whose corners lie on one line up to rounding: many have no area in float32, but one on the grid."""
    random = np.random.default_rng(seed)
    ends = random.uniform(-0.45, 0.45, (faces, 2, 3)) * (1, 1, 0.3)
    between = ends[:, :1] + random.uniform(0.2, 0.8, (faces, 1, 1)) * (ends[:, 1:] - ends[:, :1])
    normals = random.normal(size=(3 * faces, 3))
    corners = np.concatenate([ends, between], axis=1).reshape(-1, 3)
    return part(corners, np.arange(3 * faces).reshape(-1, 3), normals)


def texels(seed: int, height: int, width: int, holes: bool = False) -> np.ndarray:
    random = np.random.default_rng(seed)
    texture = random.integers(0, 256, (height, width, 4), dtype=np.uint8)
    texture[..., 3] = np.where(random.random((height, width)) < 0.4, 0, 255) if holes else 255
    return texture


def wrinkled(seed: int, rings: int, color=(0.8, 0.5, 0.3, 1)) -> Part:
    """A watertight ball with wrinkles: it has many small faces, some of them behind others at its silhouette."""
    one = sphere(0.5, rings)
    random = np.random.default_rng(seed)
    points = np.round(one.vertices * (1 + 0.1 * np.sin(9 * one.vertices @ random.normal(size=(3, 1)))), 5)
    return part(points, one.faces, one.normals, color)


def sample_grid() -> Part:
    """A grid of squares of an eighth of a pixel and larger ones, of two triangles each; the diagonals alternate."""
    steps = np.concatenate([np.arange(-64, 64, 1) / 256, [0.25]])
    points = np.array([[x, y, 0] for y in steps for x in steps])
    n = len(steps)
    faces = []
    for r in range(n - 1):
        for c in range(n - 1):
            a, b, d, e = r * n + c, r * n + c + 1, (r + 1) * n + c, (r + 1) * n + c + 1
            faces += [[a, b, e], [a, e, d]] if (r + c) % 2 else [[a, b, d], [b, e, d]]
    random = np.random.default_rng(0)
    normals = random.normal((0, 0, 3), size=(len(points), 3))
    return part(points, faces, normals / np.linalg.norm(normals, axis=1, keepdims=True))


def moved(renderer: PyrenderRenderer, seed: int, count: int = 4) -> dict[str, torch.Tensor]:
    """A batch of both sides of every coordinate's finite difference, and of `count` random values of each group."""
    random = torch.Generator().manual_seed(seed)
    start = renderer.initial()
    sides = both_sides(start, renderer.groups)
    for group, reach in (("translation", 0.05), ("rotation", 1.0), ("camera", 0.1)):
        some = reach * torch.randn(count, *start[group].shape, generator=random, dtype=torch.float64)
        sides[group] = torch.cat([sides[group], start[group] + some])
    for group in ("illumination", "color"):
        some = start[group] * torch.rand(count, *start[group].shape, generator=random, dtype=torch.float64)
        sides[group] = torch.cat([sides[group], some])
    return sides


def rasterised(resolved: ResolvedScene) -> PyrenderRenderer:
    """A renderer whose images the rasteriser draws, whatever their error is."""
    renderer = PyrenderRenderer(resolved, tolerance=1.0)
    assert renderer.rasterises
    return renderer


def error(renderer: PyrenderRenderer, parameters: dict[str, torch.Tensor]) -> ImageError:
    """The largest error of a batch of images against OpenGL's."""
    worst, ground = ImageError(), torch.tensor(GROUND)
    images, exact = renderer.render(parameters), renderer.exact().render(parameters)
    assert (exact != ground).any()
    for image, true in zip(images, exact, strict=True):
        worst = worst.or_worse(image_error(image, true, ground)[0])
    return worst
