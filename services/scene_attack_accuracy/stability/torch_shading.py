"""The torch renderer against its definition, images and gradients: sharp, flat and dark lobes; normals at the poles of
their angles, on the view axis, edge-on, and turned away.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log, pi

import numpy as np
import torch
from torch import Tensor

from scene_attack.rendering.factory import build
from scene_attack.rendering.opengl.gbuffer import GBuffer, rasterise
from scene_attack.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.torch.dsbrdf import LOG_KAPPA_RANGE, MATERIAL_UNIT, SHAPE
from scene_attack.rendering.torch.table import to_angles, to_vectors
from scene_attack.scenes.mesh import Doubles, Floats
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack_accuracy.placing import TABLES, placed, sky, sun
from scene_attack_accuracy.stability import references
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.objects import linear_problem

LOOP = DEFAULT_TOLERANCE
"""Error of a displayed value that the loop's images may have."""

SUMMED = 5e-6
"""The same error for a plan that sums every direction at every pixel: sums of positive float32 terms have a relative
error of 1e-6, and near black the display curve multiplies it by up to 12.9."""

SHARP = 2e-5
"""The same error under lobes of γ ≥ 1e3: float32 has 5e-7 of log γ, so that much of the exponent γ log n·h is unknown,
and the exponent's own exponential is steep."""

EXACT = 1e-6
"""Error of a displayed value that exact images may have: float64, but normals and base colours are float32."""

GRADIENT = 3e-4
"""Relative error of a gradient of sums, against differences of a float64 definition, which see curvature too."""

LOOKED_AT = 400
"""Pixels whose values are worked out by definition, and the brightest of an image besides."""
BRIGHTEST = 40


DEFINED = "largest error of a displayed value, against the definition in float64"


@dataclass(frozen=True)
class Errors:
    """Largest error of a displayed value, in the loop's images and in the exact ones, against the definition.

    `clipped` is the share of the pixels looked at with a value beyond display white, by the definition.
    """

    loop: float
    exact: float
    clipped: float

    def within(self, limit: float, remark: str = "") -> Measured:
        """The loop's error against its limit. Raises Broken where the exact image is off."""
        need(self.exact <= EXACT, f"the exact image is off by {self.exact:.1e}")
        return Measured(self.loop, limit, f"{DEFINED}{remark}")


@dataclass(frozen=True)
class Shading:
    """A scene of one object, rendered and by definition. `pixels` [P]: the covered ones that are looked at."""

    scene: ResolvedScene
    renderer: Renderer
    gbuffer: GBuffer
    pixels: Tensor

    @classmethod
    def of(
        cls, scene: ResolvedScene, groups: Sequence[str] | None = None, tolerance: Tolerance = DEFAULT_TOLERANCE
    ) -> "Shading":
        """Rasterises the scene and compiles it for attacks on `groups` (None: all).

        About LOOKED_AT pixels are looked at, evenly spread over the covered ones.
        """
        gbuffer = rasterise(scene)
        covered = gbuffer.coverage.flatten().nonzero()[:, 0]
        renderer = build(scene, "torch", groups=groups, tolerance=tolerance)
        return cls(scene, renderer, gbuffer, covered[:: max(1, len(covered) // LOOKED_AT)])

    @property
    def due(self) -> float:
        """The error that the loop's images may have: LOOP where the plan looks values up, SUMMED where it sums."""
        return LOOP if any("table" in stage.method for stage in self.renderer.plan.stages) else SUMMED

    def defined(self, parameters: Parameters) -> tuple[Doubles, Doubles]:
        """Displayed values [P, 3] by definition at the pixels, and the linear values before clipping."""
        values = {group: value.detach().double().numpy() for group, value in self._all(parameters).items()}
        map_ = np.asarray(self.scene.environment, np.float64)
        if "illumination" not in parameters:
            values["illumination"] = references.taken_apart(map_)[1]
        light = values["illumination"].reshape(*map_.shape[:2], 1)
        if "illumination_rgb" in parameters:
            light = np.maximum(light + values["illumination_rgb"], 0.0)
        angles = values["normals"].reshape(-1, 2)[self.pixels.numpy()]
        shaded = references.linear(
            references.vectors(angles, self.scene.view),
            values["material"][0],
            light,
            map_,
            self.scene.view[:3, 2],
            self.gbuffer.base_color.reshape(-1, 3)[self.pixels].double().numpy(),
            self.scene.description.objects[0].material,
        )
        coverage = self.gbuffer.coverage.flatten()[self.pixels].double().numpy()[:, None]
        ground = np.array(self.scene.description.ground)
        return coverage * references.displayed(shaded) + (1 - coverage) * ground, shaded

    def errors(self, parameters: Parameters) -> Errors:
        """Images with these values in place of the scene's own ({group: value}), compared. Raises Broken for NaN.

        The brightest pixels are looked at too, so that no highlight is missed.
        """
        images = []
        for renderer in (self.renderer, self.renderer.exact()):
            with torch.no_grad():
                image = renderer.render({g: v[None] for g, v in parameters.items()})[0].reshape(-1, 3).double()
            need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
            need(bool((image >= 0).all() and (image <= 1).all()), "the image has values outside [0,1]")
            images.append(image)
        shown = images[1].sum(dim=1).where(self.gbuffer.coverage.flatten() > 0, -torch.inf)
        brightest = shown.topk(min(BRIGHTEST, len(self.pixels))).indices
        pixels = torch.unique(torch.cat([self.pixels, brightest]))
        reference, shaded = replace(self, pixels=pixels).defined(parameters)
        loop, exact = (largest(image[pixels].numpy() - reference) for image in images)
        return Errors(loop, exact, float((shaded > 1).any(axis=1).mean()))

    def gradient(self, parameters: Parameters, group: str) -> tuple[Tensor, Tensor]:
        """The gradient of ⟨weights, image⟩ with respect to a group, and the weights [P, 3], fixed random numbers."""
        weights = torch.randn(len(self.pixels), 3, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
        values = {g: v.detach().clone() for g, v in parameters.items()}
        leaf = values.setdefault(group, self.renderer.initial()[group]).requires_grad_(True)
        image = self.renderer.render({g: v[None] for g, v in values.items()})[0]
        (gradient,) = torch.autograd.grad((image.reshape(-1, 3)[self.pixels].double() * weights).sum(), leaf)
        need(bool(torch.isfinite(gradient).all()), f"the gradient of {group} has values that are not finite")
        return gradient.double(), weights

    def gradient_error(self, parameters: Parameters, group: str, step: float, mask: Tensor | None = None) -> float:
        """Largest relative error of the gradient along random directions, against differences of the definition.

        Relative to the gradient's own length spread over as many coordinates as it has. `mask`: coordinates to move.
        """
        gradient, weights = self.gradient(parameters, group)
        start = {g: v.detach().double() for g, v in self._all(parameters).items()}
        random = torch.Generator().manual_seed(8)
        worst = 0.0
        for _ in range(3):
            direction = torch.randn(gradient.shape, generator=random, dtype=torch.float64)
            direction = direction if mask is None else direction * mask
            sides = [
                self.defined(start | {group: start[group] + sign * step * direction})[0].ravel() for sign in (1, -1)
            ]
            reference = float(weights.flatten().numpy() @ (sides[0] - sides[1])) / (2 * step)
            derivative = float((gradient * direction).sum())
            scale = max(abs(reference), float((gradient * (direction != 0)).norm()), 1e-12)
            worst = max(worst, abs(derivative - reference) / scale)
        return worst

    def differentiated(self, parameters: Parameters, group: str, step: float, mask: Tensor | None = None) -> Measured:
        """The error of the gradient, as `gradient_error` has it, against its limit."""
        error = self.gradient_error(parameters, group, step, mask)
        return Measured(error, GRADIENT, "relative error of the gradient, against differences of the definition")

    def _all(self, parameters: Parameters) -> Parameters:
        return self.renderer.initial() | parameters


def of_one_lobe(kappa: float, gamma: float) -> Tensor:
    """Material group [1, 3, 3, 2, 6] of one lobe with these values at all θ_d; the other two are dark."""
    material = torch.empty(1, *SHAPE, dtype=torch.float64)
    material[..., 0, :], material[..., 1, :] = LOG_KAPPA_RANGE[0], 0.0
    material[:, :, 0, 0], material[:, :, 0, 1] = log(kappa), log(gamma)
    return (material * MATERIAL_UNIT).float()


def _lobe_image(
    kappa: float, gamma: float, white: tuple[float, float] = (0.0, 0.0), map_: Floats | None = None
) -> Measured:
    """Compares an image under a map (None: a coloured sky). `white`: limits on the share of pixels clipped at white."""
    shading = Shading.of(placed(radiance=sky() if map_ is None else map_, size=TABLES))
    errors = shading.errors({"material": of_one_lobe(kappa, gamma)})
    beyond = f"{errors.clipped:.0%} of the pixels"
    need(white[0] <= errors.clipped <= white[1], f"{beyond} are beyond white by the definition")
    limit = SHARP if gamma >= 1e3 else shading.due
    return errors.within(limit, f"; {beyond} looked at held at white" if white[1] else "")


def _relative(shading: Shading, material: Tensor) -> Measured:
    """Compares the image of a material that hardly reflects, relative to its brightest value."""
    reference, linear = shading.defined({"material": material})
    full = (shading.gbuffer.coverage.flatten()[shading.pixels] == 1).numpy()
    need(0 < linear.max() < 1e-4, "the definition is not dark here")
    worst = 0.0
    for renderer in (shading.renderer, shading.renderer.exact()):
        with torch.no_grad():
            image = renderer.render({"material": material[None]})[0].reshape(-1, 3)
        seen = image[shading.pixels].double().numpy()[full]
        worst = max(worst, float(abs(seen - reference[full]).max() / reference[full].max()))
    return Measured(worst, 2e-5, "error of a displayed value relative to the brightest, which is about 1e-5")


def _dark() -> Measured:
    return _relative(Shading.of(placed(radiance=sky())), of_one_lobe(1e-6, 1.0))


def _gradient_of_lobes(kappa: float, gamma: float) -> Measured:
    shading = Shading.of(placed(radiance=0.2 * sky(), size=TABLES))
    return shading.differentiated({"material": of_one_lobe(kappa, gamma)}, "material", 1e-3 * MATERIAL_UNIT)


def _red(material: str, groups: tuple[str, ...] | None = None) -> Shading:
    """A red ball of a preset under a coloured sky, compiled for attacks on `groups` (None: the default groups)."""
    return Shading.of(placed(radiance=0.5 * sky(), thing={"material": material, "color": (0.7, 0.05, 0.0)}), groups)


def _gloss(material: str) -> Measured:
    shading = _red(material)
    _, linear = shading.defined({})
    need(bool((linear[:, 2].max() > 0.01) == (material != "brushed-metal")), "blue light is reflected, or it is not")
    return shading.errors({}).within(shading.due)


def _gloss_gradient(group: str) -> Measured:
    step = {"material": 1e-3 * MATERIAL_UNIT, "illumination_rgb": 1e-2}[group]
    return _red("glossy-paint", (group,)).differentiated({}, group, step)


def _held(by: float) -> Measured:
    """A material moved far beyond its bounds is held there by the attack, and rendered.

    At the upper bounds it is a mirror: white where it shows one of the sky's 128 texels, else nearly black. At the
    lower ones it reflects 3e-6 of the light: displayed values are compared relative to the brightest, so that black
    fails.
    """
    shading = Shading.of(placed(radiance=sky(), size=TABLES))
    start = shading.renderer.initial()["material"]
    problem = linear_problem(shading.renderer, ("material",))
    material = start + problem.limits.clamp(torch.full_like(start, by).flatten()).reshape(start.shape)
    kappa, gamma = (1e4, 1e5) if by > 0 else (1e-6, 1e-3)
    bounds = torch.tensor([log(kappa), log(gamma)], dtype=torch.float64)[:, None] * 30.0
    need(largest(material.double() - bounds) < 1e-3, f"it is not held at κ = {kappa:g} and γ = {gamma:g}")
    errors = shading.errors({"material": material})
    if by < 0:
        return _relative(shading, material)
    need(0 < errors.clipped < 0.5, f"{errors.clipped:.0%} of the pixels are beyond white by the definition")
    return errors.within(SHARP)


def lobe_cases() -> Iterator[Case]:
    """The cases of this family."""
    same = "the loop's image is within its tolerance, the exact image within rounding"
    gradient = "the gradient is that of the definition"
    overflow, mirror = "exp(1e4) overflows any float; one lit texel", "a mirror: nothing, and 0.3° further white"
    horizon, texel = "white where the texel shines, black beyond its horizon", np.roll(sun(1.0, 0.0), 8, axis=1)
    yield case("κ 1e4, γ 1", overflow, horizon, _lobe_image, 1e4, 1, (0.1, 0.9), texel, held="clipped")
    yield case("κ 1e4, γ 1e5", mirror, same, _lobe_image, 1e4, 1e5, (0.01, 0.5), held="clipped")
    yield case("κ 0.5, γ 1e5", "a lobe of 0.3°, narrower than a texel", same, _lobe_image, 0.5, 1e5)
    yield case("κ 88, γ 1e3", "exp(88) is float32's largest", same, _lobe_image, 88, 1e3, (0.1, 0.9), held="clipped")
    yield case("κ 0.5, γ 300", "a glossy lobe, not clipped", same, _lobe_image, 0.5, 300)
    yield case("κ 0.3, γ 1e-3", "γ → 0: a Lambertian body", same, _lobe_image, 0.3, 1e-3)
    yield case("κ → 0", "exp(x) − 1 for x = 1e-6", "no digits are lost in the difference", _dark)
    yield case("gradient, κ 4, γ 300", "a steep lobe", gradient, _gradient_of_lobes, 4, 300)
    yield case("gradient, κ 0.3, γ 1", "a flat lobe", gradient, _gradient_of_lobes, 0.3, 1)
    for name in ("plastic", "glossy-paint"):
        yield case(f"red {name}", "the body's colour has no blue", "the gloss has the light's colour", _gloss, name)
    metal = "all light has the metal's colour"
    yield case("red brushed-metal", "the body's colour has no blue", metal, _gloss, "brushed-metal")
    layers = "two layers, one without colour"
    for group in ("material", "illumination_rgb"):
        yield case(f"gradient by {group}, red paint", layers, gradient, _gloss_gradient, group)
    for name, by in (("material + 1e6", 1e6), ("material − 1e6", -1e6)):
        yield case(name, "a step of η = 1e3 and more", "held at its bounds, and rendered", _held, by, held="clipped")


def _all_at(shading: Shading, azimuth: float, polar: float) -> Tensor:
    """Normals [H, W, 2], every pixel's the same."""
    return torch.tensor([azimuth, polar]).expand(*shading.renderer.size, 2).contiguous()


def _image_of_normals(azimuth: float, polar: float, kappa: float = 1.0, gamma: float = 50.0) -> Measured:
    """An image whose normals all have these angles: the renderer is compiled for other ones."""
    shading = Shading.of(placed(radiance=sky(), size=TABLES))
    parameters = {"normals": _all_at(shading, azimuth, polar), "material": of_one_lobe(kappa, gamma)}
    return shading.errors(parameters).within(shading.due)


def _gradient_of_normals(azimuth: float, polar: float) -> Measured:
    shading = Shading.of(placed(radiance=0.2 * sky()))
    parameters = {"normals": _all_at(shading, azimuth, polar), "material": of_one_lobe(0.3, 1.0)}
    covered = (shading.gbuffer.coverage > 0)[..., None].expand(-1, -1, 2)
    return shading.differentiated(parameters, "normals", 1e-4, covered)


def _pole(polar: float) -> Measured:
    """At the pole the azimuth has no effect: moving it changes nothing, and its gradient is zero."""
    shading = Shading.of(placed(radiance=0.2 * sky()))
    parameters = {"normals": _all_at(shading, 0.0, polar), "material": of_one_lobe(0.3, 1.0)}
    turned = parameters | {"normals": _all_at(shading, 1.3, polar)}
    with torch.no_grad():
        images = [shading.renderer.render({g: v[None] for g, v in p.items()}) for p in (parameters, turned)]
    gradient, _ = shading.gradient(parameters, "normals")
    need(largest(gradient[..., 1]) > 0, "the gradient of the polar angle is zero too")
    gradients = float(gradient[..., 0].abs().max() / gradient[..., 1].abs().max())
    moved = largest(images[0] - images[1])
    # float32's π is off by 9e-8, so sin(polar) is 9e-8 and not 0.
    return Measured(
        max(moved, gradients), 1e-5, "change of the image under the azimuth, and its gradient against the polar's"
    )


def _there_and_back() -> Measured:
    """Vectors on every axis, beside every pole and beside the jump of the azimuth, to angles and back, in float32."""
    tiny = [0.0, 1e-30, 1e-12, 1e-7, 1e-3]
    points = [
        np.roll([sign, a, b], turn)
        for sign in (1.0, -1.0)
        for turn in range(3)
        for a in tiny
        for b in (0.0, *tiny, -1e-7)
    ]
    vectors = np.array(points, np.float64)
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    angles = to_angles(torch.tensor(vectors, dtype=torch.float32))
    need(bool(torch.isfinite(angles).all()), "an angle is not finite")
    need(bool((angles[:, 0].abs() <= np.float32(pi)).all()), "an azimuth is beyond π")
    back = to_vectors(angles.double()).numpy()
    return Measured(largest(back - unit), 5e-7, "distance of the unit vector that comes back; π is 3e-7 in float32")


def _edge_on() -> Measured:
    """A square turned to 0.6° from edge-on, seen from the front: what is still covered has a normal to the viewer."""
    scene = placed(
        "primitive/plane",
        size=(64, 64),
        camera={"azimuth": 0.0, "elevation": 0.0},
        thing={"rotation": (0, pi / 2 - 0.01, 0)},
    )
    seen = rasterise(scene)
    covered = seen.coverage > 0
    need(bool(covered.any()), "nothing is covered")
    normals = seen.normals[covered].double().numpy()
    need(bool(np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-6), "a normal is not of length 1")
    need(bool((normals @ scene.view[:3, 2] > -1e-2).all()), "a normal is turned away from the viewer")
    # The plane's own normal, turned as the object is.
    reference = np.array([np.sin(pi / 2 - 0.01), 0.0, np.cos(pi / 2 - 0.01)])
    off = np.minimum(np.linalg.norm(normals - reference, axis=1), np.linalg.norm(normals + reference, axis=1))
    return Measured(
        float(off.max()), 1e-5, "distance to the square's own normal; a normal beyond the horizon is put on it"
    )


def normal_cases() -> Iterator[Case]:
    """The cases of this family."""
    same = "the loop's image is within its tolerance, the exact image within rounding"
    right, away = "the gradient is that of the definition", pi
    idle, meaningless = "it moves nothing and has no gradient", "an angle without meaning"
    oblique = "n·v = −0.5, lit from behind"
    yield case("upper pole", "polar angle 0", same, _image_of_normals, 0.0, 0.0)
    yield case("lower pole", "polar angle π", same, _image_of_normals, 0.0, pi)
    yield case("azimuth at the upper pole", meaningless, idle, _pole, 0.0)
    yield case("azimuth at the lower pole", meaningless, idle, _pole, pi)
    yield case("gradient beside the pole", "polar angle 1e-3", right, _gradient_of_normals, 0.7, 1e-3)
    yield case("view axis", "n = v exactly, where θ_h and θ_d meet", same, _image_of_normals, 0.0, pi / 2)
    yield case("gradient on the view axis", "n = v exactly", right, _gradient_of_normals, 0.0, pi / 2)
    yield case("grazing", "n·v = 1e-6", same, _image_of_normals, pi / 2 - 1e-6, pi / 2)
    yield case("gradient when grazing", "n·v = 1e-3", right, _gradient_of_normals, pi / 2 - 1e-3, 1.2)
    yield case("back-facing", "n = −v: n·h is never positive", same, _image_of_normals, away, pi / 2, 0.3, 0.05)
    yield case("back-facing, oblique", oblique, same, _image_of_normals, 2 * pi / 3, pi / 2, 0.3, 1.0)
    yield case("angles of 1e3", "160 turns: float32 has 6e-5 radians left", same, _image_of_normals, 1000.0, 1000.0)
    yield case("vector to angles and back", "axes, poles, ±π", "the same vector comes back", _there_and_back)
    yield case("edge-on square", "0.6° from edge-on", "unit normals towards the viewer", _edge_on)
