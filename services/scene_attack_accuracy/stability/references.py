"""References in float64 numpy, straight from the definitions. They share no code and no constant with
scene_attack.rendering.

`linear` and its parts: the torch renderer's shading sum, in world space where the renderer works in the camera's,
without bounds on exponents (what overflows is infinitely bright, and displayed as 1), every direction and lobe at once.

Rays: the surface that a ray through each sample of a pixel meets, for both rasterisers.

Lamps: the pyrender renderer's Lambertian body under a rough dielectric coat, in the textbooks' own form: the GGX
distribution (Walter et al. 2007, equation 33), Smith's height-correlated shadowing from its Λ (Heitz 2014, equation
99), Schlick's Fresnel term. It meets the surface by rays.

Surfaces of glTF files, from docs/reports/gltf.md: pyrender's BRDF, written in angles: GGX with α = roughness²,
Schlick's Fresnel term, Schlick's approximation of Smith's shadowing with k = (roughness + 1)² / 8, a diffuse body.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import comb, cos, pi, tan

import numpy as np
from numpy.typing import NDArray

from scene_attack.scenes.mesh import Doubles, Longs
from scene_attack.scenes.resolve import ResolvedScene

ILLUMINATION_MEAN, MATERIAL_UNIT, WHITE = 10.0, 30.0, 0.9
"""Mean intensity of a map; material coordinates per natural logarithm; the brightest white surface's linear value."""

UNCOLORED = {"plastic": (1, 2), "glossy-paint": (1, 2)}
"""Lobes of dielectrics' gloss by preset: the mesh's colour does not multiply what they reflect."""

COSINE_FLOOR = 1e-4
"""Lower bound of n·h in a lobe."""


def texels(rows: int, cols: int) -> tuple[Doubles, Doubles]:
    """Directions [rows·cols, 3] and solid angles [rows·cols] of a map's texels (scene_attack.scenes.environment)."""
    theta, phi = (np.arange(rows) + 0.5) * pi / rows, (np.arange(cols) + 0.5) * 2 * pi / cols
    ring = np.stack([np.sin(phi), np.zeros(cols), np.cos(phi)], axis=1)
    towards = np.sin(theta)[:, None, None] * ring + np.cos(theta)[:, None, None] * np.array([0.0, 1.0, 0.0])
    # 2 sin θ sin(Δθ/2) Δφ: the difference of two cosines without cancellation.
    solid = 2 * np.sin(theta) * np.sin(pi / rows / 2) * 2 * pi / cols
    return towards.reshape(-1, 3), np.repeat(solid, cols)


def taken_apart(radiance: Doubles) -> tuple[Doubles, Doubles, float]:
    """Chroma [D, 3], intensity [D] and exposure of a map [rows, cols, 3] with some light in it."""
    rows, cols, _ = radiance.shape
    towards, solid = texels(rows, cols)
    flat = radiance.reshape(-1, 3).astype(np.float64)
    luminance = flat @ (0.2126, 0.7152, 0.0722)
    chroma = np.ones_like(flat)
    lit = luminance > 0
    chroma[lit] = flat[lit] / luminance[lit, None]
    intensity = luminance * (ILLUMINATION_MEAN * 4 * pi / (luminance @ solid))
    facing = np.maximum(texels(16, 32)[0] @ towards.T, 0.0)
    brightest = (facing @ (chroma * (intensity * solid)[:, None]) / pi).max()
    return chroma, intensity, WHITE / float(brightest)


def lobes(coefficients: Doubles, theta_d: Doubles) -> tuple[Doubles, Doubles]:
    """log κ and log γ [D] of coefficients [2, 6], natural logarithms, at θ_d [D]."""
    t = theta_d / (pi / 2)
    bernstein = np.stack([comb(5, i) * t**i * (1 - t) ** (5 - i) for i in range(6)], axis=1)
    return bernstein @ coefficients[0], bernstein @ coefficients[1]


def linear(
    normals: Doubles,
    material: Doubles,
    intensity: Doubles,
    radiance: Doubles,
    back: Doubles,
    base_color: Doubles,
    preset: str = "matte",
) -> Doubles:
    """Linear image values [P, 3], +inf where a lobe overflows.

    normals [P, 3] and `back` [3] (towards the viewer), unit, world space; material [3, 3, 2, 6] and intensity,
    [rows, cols] or by channel [rows, cols, 3], in the units of the renderer's groups; radiance [rows, cols, 3] the
    unperturbed map; base_color [P, 3]; `preset` the material's name before it was perturbed.
    """
    towards, solid = texels(*radiance.shape[:2])
    chroma, _, exposure = taken_apart(radiance)
    power = exposure * chroma * intensity.reshape(len(solid), -1) * solid[:, None]
    total = towards + back
    length = np.linalg.norm(total, axis=1)
    half = np.where(length[:, None] > 1e-7, total / np.maximum(length, 1e-300)[:, None], 0.0)
    theta_d = np.where(length > 1e-7, np.arccos(np.clip((half * towards).sum(1), -1, 1)), pi / 2)
    cosine = normals @ towards.T
    log_half = np.log(np.maximum(normals @ half.T, COSINE_FLOOR))
    out = np.zeros((len(normals), 3))
    with np.errstate(over="ignore"):
        for channel in range(3):
            weight = np.maximum(cosine, 0.0) * power[:, channel]
            for number, lobe in enumerate(material[channel] / MATERIAL_UNIT):
                log_kappa, log_gamma = lobes(lobe, theta_d)
                rho = np.expm1(np.exp(log_kappa + np.exp(log_gamma) * log_half))
                # Without light or beyond the horizon an infinite lobe reflects nothing.
                sent = (np.where(weight > 0, rho, 0.0) * weight).sum(axis=1)
                color = 1.0 if number in UNCOLORED.get(preset, ()) else base_color[:, channel]
                out[:, channel] += np.where(color > 0, sent, 0.0) * color
    return out


def displayed(values: Doubles) -> Doubles:
    """The sRGB curve on [0,1] (IEC 61966-2-1)."""
    clipped = np.clip(values, 0.0, 1.0)
    curved: Doubles = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return curved


def vectors(angles: Doubles, view: Doubles) -> Doubles:
    """Unit normals [P, 3] in world space of azimuth and polar angle [P, 2] in the frame of the camera `view` [4, 4]."""
    azimuth, polar = angles[:, :1], angles[:, 1:]
    right, up, back = view[:3, 0], view[:3, 1], view[:3, 2]
    return np.sin(polar) * np.sin(azimuth) * right + np.cos(polar) * up + np.sin(polar) * np.cos(azimuth) * back


Bools = NDArray[np.bool_]

NEAREST = 0.01
"""Distance from the camera below which nothing is visible, scene units."""

RAYS_AT_ONCE = 2**22
"""Rays times triangles held at a time."""


@dataclass(frozen=True)
class Hits:
    """The surfaces behind P pixels at S samples each. The first four fields are undefined where `depth` is infinite.

    positions [P, S, 3] and unit normals [P, S, 3] (interpolated, on the viewer's side), world space; colors [P, S, 3],
    linear, without textures; planes [P, S, 3], the unit normals of the flat triangles; depth [P, S] along the view.
    """

    positions: Doubles
    normals: Doubles
    colors: Doubles
    planes: Doubles
    depth: Doubles

    @property
    def coverage(self) -> Doubles:
        """Share of each pixel's samples that meet an object, [P]."""
        return np.asarray(np.isfinite(self.depth).mean(axis=1))

    @property
    def coplanar(self) -> Bools:
        """Whether all samples of a pixel lie in one plane, bool [P]."""
        alike = np.abs(self.planes - self.planes[:, :1]).max(axis=(1, 2)) < 1e-9
        return np.asarray(alike & np.isfinite(self.depth).all(axis=1))

    def mean(self, values: Doubles) -> Doubles:
        """The mean over the samples that meet an object, [P, …]; 0 where none does."""
        hit = np.isfinite(self.depth).reshape(*self.depth.shape, *(1,) * (values.ndim - 2))
        return np.asarray(np.where(hit, values, 0.0).sum(axis=1) / np.maximum(hit.sum(axis=1), 1))


def cast(scene: ResolvedScene, samples: int, pixels: Longs | None = None) -> Hits:
    """Rays through `samples` × `samples` points of each pixel (None: all, row by row), for opaque objects.

    Triangles are intersected by definition (Möller and Trumbore 1997), from both sides, at NEAREST or farther.
    """
    height, width = scene.description.camera.size
    pixels = np.arange(height * width) if pixels is None else pixels
    eye, rays = scene.view[:3, 3], _rays(scene, samples, pixels)
    depth = np.full(len(rays), np.inf)
    normals, colors, planes = (np.zeros((len(rays), 3)) for _ in range(3))
    for placed in scene.placed:
        model = placed.model
        for part in placed.mesh.parts:
            corners = (part.vertices.astype(np.float64) @ model[:3, :3].T + model[:3, 3] - eye)[part.faces]
            own = (part.normals.astype(np.float64) @ np.linalg.inv(model[:3, :3]))[part.faces]
            step = max(1, RAYS_AT_ONCE // len(rays))
            for start in range(0, len(corners), step):
                t, face, weights = _nearest(rays, corners[start : start + step])
                seen = t < depth
                face += start
                depth[seen] = t[seen]
                colors[seen] = part.color[:3].astype(np.float64) * placed.described.color
                normals[seen] = (weights[:, :, None] * own[face]).sum(axis=1)[seen]
                a, b, c = corners[face[seen]].swapaxes(0, 1)
                planes[seen] = np.cross(b - a, c - a)
    planes = _unit(planes * _sign(-planes, rays))
    positions = eye + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    normals = _facing(normals, planes, _unit(-rays))
    shape = (len(pixels), samples**2)
    vectors = [values.reshape(*shape, 3) for values in (positions, normals, colors, planes)]
    return Hits(vectors[0], vectors[1], vectors[2], vectors[3], depth.reshape(shape))


def of_sphere(scene: ResolvedScene, radius: float) -> tuple[Doubles, Bools]:
    """Normals [P, 3] of a sphere about the origin where pixels' middle rays meet it, and which pixels, bool [H·W]:
    those well inside its outline."""
    eye, rays = scene.view[:3, 3], _unit(_rays(scene, 1, np.arange(np.prod(scene.description.camera.size))))
    nearest = -rays @ eye
    miss = np.linalg.norm(eye + nearest[:, None] * rays, axis=1)
    seen = miss < 0.85 * radius
    distance = nearest[seen] - np.sqrt(radius**2 - miss[seen] ** 2)
    return (eye + distance[:, None] * rays[seen]) / radius, seen


def _rays(scene: ResolvedScene, samples: int, pixels: Longs) -> Doubles:
    """Directions [P · samples², 3] from the eye through the samples of pixels [P], of length 1 along the view."""
    height, width = scene.description.camera.size
    rows, columns = np.divmod(pixels, width)
    inside = (np.arange(samples) + 0.5) / samples
    down, across = (axis.ravel() for axis in np.meshgrid(inside, inside, indexing="ij"))
    tangent = tan(scene.description.camera.field_of_view / 2)
    y = (1 - 2 * (rows[:, None] + down) / height).ravel() * tangent
    x = (2 * (columns[:, None] + across) / width - 1).ravel() * tangent * width / height
    right, up, back = (scene.view[:3, k] for k in range(3))
    return np.asarray(x[:, None] * right + y[:, None] * up - back)


def _nearest(rays: Doubles, triangles: Doubles) -> tuple[Doubles, Longs, Doubles]:
    """Distance ≥ NEAREST along each ray (in lengths of the ray; inf for none) to the nearest of the triangles
    [F, 3, 3], which one that is, and the weights [N, 3] of its corners there."""
    origin, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    # With the eye at 0: t = origin·normal / ray·normal, and the barycentric coordinates from the same determinant.
    across, numerator = rays @ normal.T, (origin * normal).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = numerator / across
        u = rays @ np.cross(second, origin).T / across
        v = -(rays @ np.cross(first, origin).T) / across
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= NEAREST)
    t = np.where(inside, t, np.inf)
    face = t.argmin(axis=1)
    at = np.arange(len(rays)), face
    hit = np.isfinite(t[at])
    u, v = np.where(hit, u[at], 0.0), np.where(hit, v[at], 0.0)
    return t[at], face, np.stack([1 - u - v, u, v], axis=1)


def _facing(normals: Doubles, planes: Doubles, to_eye: Doubles) -> Doubles:
    """Unit normals on the side from which the flat triangle is seen; one bent beyond the horizon is put on it."""
    normals = _unit(normals * _sign(normals, planes))
    facing = _dot(normals, to_eye)
    return np.where(facing < 0, _unit(normals - facing * to_eye), normals)


def _sign(one: Doubles, other: Doubles) -> Doubles:
    return np.where(_dot(one, other) < 0, -1.0, 1.0)


def _dot(one: Doubles, other: Doubles) -> Doubles:
    return np.asarray((one * other).sum(axis=1, keepdims=True))


def _unit(vectors: Doubles) -> Doubles:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


ROUGHNESS, NORMAL_REFLECTANCE, EXPOSURE = 0.45, 0.04, 0.5


@dataclass(frozen=True)
class Lamps:
    """Light: ambient radiance; point lights [L, 4], each its radiant intensity and its position; suns [S, 4], each its
    irradiance and the direction in which its light travels; spots [K, 9], each its radiant intensity, its position, the
    direction of its axis, and the angles from the axis where its light begins to fall off and where it ends."""

    ambient: float
    points: Doubles = field(default_factory=lambda: np.zeros((0, 4)))
    suns: Doubles = field(default_factory=lambda: np.zeros((0, 4)))
    spots: Doubles = field(default_factory=lambda: np.zeros((0, 9)))

    def arriving(self, positions: Doubles) -> Iterator[tuple[Doubles, Doubles]]:
        """Each light's irradiance [P, 1] of surfaces that face it, and the unit vectors [P, 3] to it, at points [P, 3].

        Within its outer angle a spot light falls off as KHR_lights_punctual says: with the square of a straight line in
        the cosine.
        """
        for intensity, *place in self.points:
            distance, to_light = _way(positions, place)
            yield intensity / distance**2, to_light
        for irradiance, *travel in self.suns:
            to_light = -np.array(travel) / np.linalg.norm(travel)
            yield np.full((len(positions), 1), irradiance), np.broadcast_to(to_light, positions.shape)
        for intensity, x, y, z, *axis, inner, outer in self.spots:
            distance, to_light = _way(positions, [x, y, z])
            cosine = -to_light @ (np.array(axis) / np.linalg.norm(axis))
            cone = np.clip((cosine - cos(outer)) / (cos(inner) - cos(outer)), 0.0, 1.0) ** 2
            yield intensity * cone[:, None] / distance**2, to_light


Shading = Callable[[Doubles, Doubles, Doubles, Doubles, Lamps], Doubles]
"""A function with the signature of `radiance`."""


@dataclass(frozen=True)
class Expected:
    """The values of some pixels of an image by definition: `radiance` [P, 3], and `shown` [P, 3], the displayed values.

    `pixels` [P] are those that lie wholly in one plane of an object: there one point stands for the pixel.
    """

    pixels: Longs
    radiance: Doubles
    shown: Doubles


def expected(
    scene: ResolvedScene, lamps: Lamps | None = None, pixels: Longs | None = None, shading: Shading | None = None
) -> Expected:
    """Computes `pixels` (None: all) of the image by its definition. `lamps`: None for the scene's own; `shading` of the
    surface: None for the coated body."""
    height, width = scene.description.camera.size
    pixels = np.arange(height * width) if pixels is None else pixels
    pixels = pixels[cast(scene, 4, pixels).coplanar]
    middle = cast(scene, 1, pixels)
    values = (shading or radiance)(
        middle.positions[:, 0],
        middle.normals[:, 0],
        middle.colors[:, 0],
        scene.view[:3, 3],
        lamps or lamps_of(scene),
    )
    return Expected(pixels, values, displayed(EXPOSURE * values))


def lamps_of(scene: ResolvedScene) -> Lamps:
    """The scene's own light."""
    lights = scene.description.lights
    points = [[light.energy, *light.position] for light in lights.points]
    suns = [[light.energy, *light.direction] for light in lights.directional]
    spots = [
        [light.energy, *light.position, *light.direction, light.inner_angle, light.outer_angle]
        for light in lights.spots
    ]
    arrays = (np.array(rows).reshape(-1, width) for rows, width in ((points, 4), (suns, 4), (spots, 9)))
    return Lamps(lights.ambient, *arrays)


def radiance(positions: Doubles, normals: Doubles, colors: Doubles, eye: Doubles, lamps: Lamps) -> Doubles:
    """Linear radiance [P, 3] towards `eye` [3] of points [P, 3] with unit normals [P, 3] and base colours [P, 3].

    The ambient light is a sky of radiance ambient · (1 + w_y / 2) in direction w. A Lambertian body makes
    ambient · (1 + n_y / 3) of it, and the coat adds its Fresnel term, whose rise its roughness damps.
    """
    to_eye = _unit(eye - positions)
    facing = _dot(normals, to_eye)
    gloss = lamps.ambient * _schlick(1 - ROUGHNESS, facing)
    total = lamps.ambient * (1 + normals[:, 1:2] / 3) * colors + gloss
    for facing_it, to_light in lamps.arriving(positions):
        irradiance = facing_it * np.maximum(_dot(normals, to_light), 0.0)
        total = total + irradiance * (colors / pi + _coat(normals, to_eye, to_light))
    return np.asarray(total)


def _coat(normals: Doubles, to_eye: Doubles, to_light: Doubles) -> Doubles:
    """D G F / (4 n·l n·v) [P, 1]; 0 where the light is behind the surface."""
    alpha = ROUGHNESS**2
    half = _unit(to_eye + to_light)
    nh, nl, nv = (np.maximum(_dot(normals, way), 1e-9) for way in (half, to_light, to_eye))
    tangent2 = 1 / nh**2 - 1
    distribution = alpha**2 / (pi * nh**4 * (alpha**2 + tangent2) ** 2)
    shadowing = 1 / (1 + _lambda(nl, alpha) + _lambda(nv, alpha))
    return np.asarray(distribution * shadowing * _schlick(1.0, _dot(to_eye, half)) / (4 * nl * nv))


def _lambda(cosine: Doubles, alpha: float) -> Doubles:
    """Smith's Λ of the GGX distribution."""
    return np.asarray((np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2)


def _schlick(grazing: float, cosine: Doubles) -> Doubles:
    return NORMAL_REFLECTANCE + (grazing - NORMAL_REFLECTANCE) * (1 - np.clip(cosine, 0, 1)) ** 5


def _way(positions: Doubles, place: list[float]) -> tuple[Doubles, Doubles]:
    """Distances [P, 1] and unit vectors [P, 3] from points to a place."""
    way = np.array(place) - positions
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    return distance, way / distance


SMOOTHEST = 0.04
"""The lowest roughness that is drawn."""


@dataclass(frozen=True)
class Surface:
    """A material: `texel` [3] multiplies the base colour; `normal` [3], a unit vector, replaces the geometry's. If
    `given`, its metallic and roughness are a scene's, and its shadowing is Smith's, height-correlated (Heitz 2014)."""

    metallic: float
    roughness: float
    texel: tuple[float, float, float] = (1.0, 1.0, 1.0)
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    occlusion: float = 1.0
    normal: tuple[float, float, float] | None = None
    given: bool = False

    def radiance(self, positions: Doubles, normals: Doubles, colors: Doubles, eye: Doubles, lamps: Lamps) -> Doubles:
        """Linear radiance [P, 3] as `lamps.radiance` has it, of base colours [P, 3].

        The sky has radiance ambient · (1 + w_y / 2) in direction w: a rough surface sees its cosine-weighted mean and a
        smooth one what it mirrors, and the occlusion map darkens this light alone.
        """
        normals = normals if self.normal is None else np.tile(self.normal, (len(positions), 1))
        base, rough = colors * self.texel, max(self.roughness, SMOOTHEST)
        body, f0 = 0.96 * (1 - self.metallic) * base, 0.04 * (1 - self.metallic) + self.metallic * base
        to_eye = _unit(eye - positions)
        seen = _dot(normals, to_eye)
        share = f0 + np.maximum(1 - rough - f0, 0) * (1 - seen) ** 5
        mean, mirrored = 1 + normals[:, 1:2] / 3, 1 + (2 * seen * normals - to_eye)[:, 1:2] / 2
        sky = (1 - share) * body * mean + share * (rough * mean + (1 - rough) * mirrored)
        total = np.array(self.emission) + lamps.ambient * self.occlusion * sky
        for facing_it, to_light in lamps.arriving(positions):
            lit = np.maximum(_dot(normals, to_light), 0.0)
            half = _unit(to_eye + to_light)
            cosine = np.clip(_dot(normals, half), 1e-9, 1.0)
            slope2, alpha = (1 - cosine**2) / cosine**2, rough**2
            distribution = alpha**2 / (pi * cosine**4 * (alpha**2 + slope2) ** 2)
            k = (rough + 1) ** 2 / 8
            # Each side's shadowing over its cosine, which cancels the cosine of the microfacet formula.
            shadowing = 1 / (seen * (1 - k) + k) / (lit * (1 - k) + k)
            if self.given:
                tangents = [np.sqrt(1 / np.maximum(cos, 1e-9) ** 2 - 1) for cos in (seen, lit)]
                beneath = sum((np.sqrt(1 + (alpha * tangent) ** 2) - 1) / 2 for tangent in tangents)
                shadowing = 1 / (1 + beneath) / (seen * np.maximum(lit, 1e-9))
            fresnel = f0 + (1 - f0) * (1 - _dot(to_eye, half)) ** 5
            total = total + facing_it * lit * ((1 - fresnel) * body / pi + fresnel * distribution * shadowing / 4)
        return np.asarray(total)
