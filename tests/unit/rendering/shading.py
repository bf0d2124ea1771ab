"""A sphere's G-buffer in closed form, and the shading sum written straight from its formula, one term at a time."""

from math import acos, comb, cos, exp, pi, sin

import numpy as np
import torch

from scene_attack.rendering.opengl.gbuffer import GBuffer
from scene_attack.rendering.torch.dsbrdf import COSINE_FLOOR, ILLUMINATION_MEAN, MATERIAL_UNIT, WHITE
from scene_attack.scenes.description import Camera, Scene, SceneObject
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering import dents, dials, lamps, paints
from tests.unit.rendering.shapes import mesh, placed

UNCOLORED = {"plastic": (1, 2), "glossy-paint": (1, 2), "rubber": (1, 2)}
"""Lobes by preset that the mesh's colour does not multiply."""
GROUND = (51 / 255, 102 / 255, 204 / 255)


def sphere_scene(
    size=(12, 12), environment=None, materials=("plastic",), azimuth=0.61, elevation=0.35
) -> ResolvedScene:
    description = Scene(
        camera=Camera(size=size, azimuth=azimuth, elevation=elevation),
        objects=tuple(SceneObject(mesh="primitive/sphere", material=m) for m in materials),
        ground=GROUND,
    )
    scene = placed(description, *(mesh() for _ in materials))  # its G-buffer is made without them
    object.__setattr__(scene, "environment", sky() if environment is None else environment)
    return scene


def sphere_gbuffer(scene: ResolvedScene, radius=0.8, albedo=(0.7, 0.5, 0.3)) -> GBuffer:
    """The unit sphere seen from afar, `radius` of the frame; objects are its vertical slices, from left to right."""
    height, width = scene.description.camera.size
    y, x = np.meshgrid(1 - (2 * np.arange(height) + 1) / height, (2 * np.arange(width) + 1) / width - 1, indexing="ij")
    x, y = x / radius, y / radius
    rim = np.sqrt(x**2 + y**2)
    coverage = np.clip((1 - rim) * radius * height / 2 + 0.5, 0, 1)
    inside = np.minimum(1.0, 1 / np.maximum(rim, 1e-9))
    z = np.sqrt(np.maximum(0, 1 - (x * inside) ** 2 - (y * inside) ** 2))
    normals = np.stack([x * inside, y * inside, z], -1) @ scene.view[:3, :3].T
    covered = coverage > 0
    count = len(scene.description.objects)
    owner = np.clip(((x + 1) / 2 * count).astype(int), 0, count - 1)
    return GBuffer(
        normals=torch.tensor(normals * covered[..., None], dtype=torch.float32),
        coverage=torch.tensor(coverage, dtype=torch.float32),
        base_color=torch.tensor(np.array(albedo) * covered[..., None], dtype=torch.float32),
        depth=torch.full((height, width), scene.description.camera.distance),
        object_index=torch.tensor(np.where(covered, owner, -1)),
        backend="closed form",
    )


def sky(rows=4, cols=8, seed=0) -> np.ndarray:
    """A coloured map of high contrast with one black texel."""
    rng = np.random.default_rng(seed)
    environment = np.exp(rng.normal(size=(rows, cols, 3))).astype(np.float32)
    environment[0, 0] = 0
    return environment


def lambertian(albedo=1.0) -> torch.Tensor:
    """Coordinates [3, 3, 2, 6] of a Lambertian material: one lobe of γ = e⁻³⁰, the others dark."""
    material = torch.full((3, 3, 2, 6), -60.0, dtype=torch.float64)
    material[:, 0, 0], material[:, :, 1] = float(np.log(np.log1p(albedo / pi))), -30.0
    return material * MATERIAL_UNIT


def texels(rows: int, cols: int) -> list[tuple[int, int, np.ndarray, float]]:
    """Row, column, direction and solid angle of each texel."""
    found = []
    for i in range(rows):
        for j in range(cols):
            theta, phi = (i + 0.5) * pi / rows, (j + 0.5) * 2 * pi / cols
            direction = np.array([sin(theta) * sin(phi), cos(theta), sin(theta) * cos(phi)])
            found.append((i, j, direction, 2 * pi / cols * (cos(i * pi / rows) - cos((i + 1) * pi / rows))))
    return found


def reference_exposure(environment: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Chroma, intensity and exposure of a map, by their definitions."""
    rows, cols, _ = environment.shape
    weights = np.array([0.2126, 0.7152, 0.0722])
    luminance = environment.astype(float) @ weights
    mean = sum(luminance[i, j] * solid for i, j, _, solid in texels(rows, cols)) / (4 * pi)
    chroma = np.ones_like(environment, dtype=float)
    for i in range(rows):
        for j in range(cols):
            if luminance[i, j] > 0:
                chroma[i, j] = environment[i, j] / luminance[i, j]
    intensity = luminance * ILLUMINATION_MEAN / mean
    brightest = 0.0
    for _, _, normal, _ in texels(16, 32):
        total = np.zeros(3)
        for i, j, direction, solid in texels(rows, cols):
            total += chroma[i, j] * intensity[i, j] * max(0.0, normal @ direction) * solid / pi
        brightest = max(brightest, total.max())
    return chroma, intensity, WHITE / brightest


def reference_brdf(coefficients: np.ndarray, theta_h: float, theta_d: float) -> float:
    """One channel's ρ of coefficients [lobes, 2, 6] (logarithms of κ and γ)."""
    t = theta_d / (pi / 2)
    rho = 0.0
    for lobe in coefficients:
        log_kappa, log_gamma = (sum(comb(5, i) * t**i * (1 - t) ** (5 - i) * c[i] for i in range(6)) for c in lobe)
        rho += exp(exp(log_kappa) * cos(theta_h) ** exp(log_gamma)) - 1
    return rho


def place_of(scene: ResolvedScene, gbuffer: GBuffer, at: tuple[int, int]) -> np.ndarray:
    """The point [3] that a pixel shows, in its object's frame."""
    right, up, back = scene.view[:3, :3].T
    height, width = gbuffer.coverage.shape
    across, down = (2 * at[1] + 1) / width - 1, 1 - (2 * at[0] + 1) / height
    ray = across / scene.projection[0, 0] * right + down / scene.projection[1, 1] * up - back
    model = np.asarray(scene.models[int(gbuffer.object_index[at])])
    place = np.linalg.solve(model, np.append(scene.view[:3, 3] + float(gbuffer.depth[at]) * ray, 1.0))[:3]
    return place.clip(-FIT_RADIUS, FIT_RADIUS)  # this G-buffer's sphere is wider than an object


def dented(
    scene: ResolvedScene, gbuffer: GBuffer, at: tuple[int, int], normal: np.ndarray, coefficients: np.ndarray
) -> np.ndarray:
    """The unit normal of a pixel, turned by the dents of its object."""
    owner, place = int(gbuffer.object_index[at]), place_of(scene, gbuffer, at)
    model = np.asarray(scene.models[owner])
    turn = model[:3, :3] / np.linalg.norm(model[:3, 0])
    slope = turn @ dents.gradient(place[None], coefficients[owner])[0]
    raised = normal - slope + (slope @ normal) * normal
    return raised / np.linalg.norm(raised)


def reference_image(scene: ResolvedScene, gbuffer: GBuffer, parameters: dict[str, torch.Tensor]) -> np.ndarray:
    """The image [H, W, 3] by its definition: loops over pixels, directions, channels and lobes, in world space."""
    environment = np.asarray(scene.environment)
    chroma, own, exposure = reference_exposure(environment)
    angles, intensity, added, material = (
        parameters[group].detach().double().numpy()
        for group in ("normals", "illumination", "illumination_rgb", "material")
    )
    if "lamp" in parameters:
        solid = np.reshape([of for *_, of in texels(*own.shape)], own.shape)
        added = added + lamps.added(chroma, own, intensity, solid, parameters["lamp"].detach().double().numpy())
    if "dials" in parameters:
        names = [described.material for described in scene.description.objects]
        settings = parameters["dials"].double().numpy()
        material = np.stack([dials.turned(*own) for own in zip(names, material, settings, strict=True)])
    right, up, back = scene.view[:3, :3].T
    height, width = gbuffer.coverage.shape
    image = np.empty((height, width, 3))
    ground = np.array(scene.description.ground)
    for y in range(height):
        for x in range(width):
            covered = float(gbuffer.coverage[y, x])
            if covered == 0:
                image[y, x] = ground
                continue
            azimuth, polar = angles[y, x]
            normal = sin(polar) * sin(azimuth) * right + cos(polar) * up + sin(polar) * cos(azimuth) * back
            if "bump" in parameters:
                normal = dented(scene, gbuffer, (y, x), normal, parameters["bump"].double().numpy())
            owner, base = int(gbuffer.object_index[y, x]), gbuffer.base_color[y, x].double().numpy()
            if "paint" in parameters:
                point = place_of(scene, gbuffer, (y, x))
                base = paints.painted(point[None], base[None], parameters["paint"][owner].double().numpy())[0]
            gloss = UNCOLORED.get(scene.description.objects[owner].material, ())
            total = np.zeros(3)
            for i, j, direction, solid in texels(*environment.shape[:2]):
                if normal @ direction <= 0:
                    continue
                half = (direction + back) / np.linalg.norm(direction + back)
                theta_h = acos(min(1.0, max(COSINE_FLOOR, normal @ half)))
                theta_d = acos(min(1.0, half @ direction))
                for c in range(3):
                    rho = 0.0
                    for lobe, own in enumerate(material[owner, c] / MATERIAL_UNIT):
                        rho += reference_brdf(own[None], theta_h, theta_d) * (1.0 if lobe in gloss else base[c])
                    light = max(0.0, intensity[i, j] + added[i, j, c])
                    total[c] += rho * chroma[i, j, c] * light * (normal @ direction) * solid
            linear = np.clip(exposure * total, 0, 1)
            shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
            image[y, x] = covered * shown + (1 - covered) * ground
    return image
