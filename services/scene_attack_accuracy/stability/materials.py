"""Metallic-roughness materials of glTF files: their formula and maps, the sides of a face, alpha."""

from collections.abc import Iterator
from math import pi
from typing import Any

import numpy as np

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.opengl import context
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.mesh import Bytes, Doubles, Part, fitted
from scene_attack.scenes.reading.formats import read_mesh
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack_accuracy.placing import placed
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.gltf_file import file_of
from scene_attack_accuracy.stability.meshes import TEXEL, decoded
from scene_attack_accuracy.stability.pyrender_light import formula_error, radiance_at
from scene_attack_accuracy.stability.references import Surface, expected

FORMULA = 1e-5
"""Relative error of a radiance: float32 positions and two dozen float32 products (measured: 2e-6, and 7e-6 where the
highlight is narrow)."""

FLOOR = 0.01
"""The same error for a floor of two triangles: OpenGL shades both where they meet, each up to a quarter pixel from the
middle. The rasteriser, which shades the middle, is off by 2e-7."""

CAMERA = {"azimuth": 0.4, "elevation": 0.3}
LIGHTS: dict[str, Any] = {
    "ambient": 0.3,
    "points": [{"energy": 9.0, "position": (0.5, 0.8, 1.4)}],
    "directional": [{"energy": 2.0, "direction": (-0.3, -1.0, -0.6)}],
    "spots": [
        {
            "energy": 25.0,
            "position": (-1.0, 0.4, 1.5),
            "direction": (1.1, -0.3, -1.4),
            "inner_angle": 0.1,
            "outer_angle": 0.35,
        }
    ],
}
BASE, COLOR = (0.9, 0.55, 0.3), (0.8, 1.0, 0.6)
"""The file's base colour factor and the object's colour."""

BEND = np.array([[[166, 191, 230]]], np.uint8)
"""A normal map that bends the normal along u by about 0.3 and along v by about 0.5."""

TRIANGLE = {
    "POSITION": np.array([(-1, -1, 0), (3, -1, 0), (-1, 3, 0)], np.float64),
    "NORMAL": np.tile([0.0, 0.0, 1.0], (3, 1)),
    "TEXCOORD_0": np.array([(0, 1), (2, 1), (0, -1)], np.float64),
    "indices": np.array([0, 1, 2]),
}
"""A triangle in z = 0 that faces +z, u to the right and v down: without a diagonal at which a pixel has two parts."""

MIRRORED = {"TEXCOORD_0": TRIANGLE["TEXCOORD_0"] * (-1, 1)}
"""The same triangle with u to the left."""


def _scene(material: dict[str, Any], arrays: dict[str, Any], thing: dict[str, Any], **node: Any) -> ResolvedScene:
    parts = read_mesh(file_of(TRIANGLE | arrays, material, **node), "glb", 10)
    return placed(parts, size=(33, 33), camera=CAMERA, thing={"color": COLOR} | thing, lights=LIGHTS)


def _material(metallic: float, roughness: float, **more: Any) -> dict[str, Any]:
    surface = {"baseColorFactor": (*BASE, 1.0), "metallicFactor": metallic, "roughnessFactor": roughness}
    return {"pbrMetallicRoughness": surface | more.pop("surface", {}), **more}


def _against_formula(scene: ResolvedScene, surface: Surface, limit: float = FORMULA) -> Measured:
    """Compares radiance, displayed values, normals and base colours with the formula, where the surface is flat."""
    reference = expected(scene, shading=surface.radiance)
    worst = formula_error(scene, reference)
    seen = rasterise(scene)
    colors = seen.base_color.reshape(-1, 3)[reference.pixels].double().numpy()
    factor = scene.meshes[0].parts[0].color[:3].astype(np.float64)
    worst = max(worst, largest(colors - factor * COLOR * surface.texel))
    if surface.normal is not None:
        normals = seen.normals.reshape(-1, 3)[reference.pixels].double().numpy()
        worst = max(worst, largest(normals - surface.normal))
    what = "largest error of radiance (relative to the brightest), of displayed values and of the G-buffer"
    return Measured(worst, limit, f"{what}; {len(reference.pixels)} pixels")


def _plain(metallic: float, roughness: float, **more: Any) -> Measured:
    """A surface of factors alone."""
    surface = Surface(metallic, roughness, emission=more.get("emissiveFactor", (0.0, 0.0, 0.0)))
    return _against_formula(_scene(_material(metallic, roughness, **more), {}, {}), surface)


def _given(metallic: float, roughness: float) -> Measured:
    """A surface of factors alone, which the scene gives to a triangle that has no glTF material."""
    arrays = [TRIANGLE[name].astype(np.float32) for name in ("POSITION", "NORMAL")]
    color = np.array([*BASE, 1.0], np.float32)
    part = Part(arrays[0], arrays[1], TRIANGLE["indices"].astype(np.int32)[None], None, color, None)
    thing = {"color": COLOR, "metallic": metallic, "roughness": roughness}
    scene = placed(fitted((part,)), size=(33, 33), camera=CAMERA, thing=thing, lights=LIGHTS)
    return _against_formula(scene, Surface(metallic, roughness, given=True))


def _floor() -> Measured:
    """A cube over a floor that reaches behind the camera, both of one given surface, in the light of a point alone,
    which the rasteriser knows too."""
    factors = {"metallic": 0.5, "roughness": 0.4}
    thing = {"color": COLOR, "scale": 0.5, "rotation": (0.3, 0.5, 0.2)} | factors
    floor = {"size": 8.0, "height": -0.4, "color": COLOR} | factors
    light = {"ambient": 0.3, "points": LIGHTS["points"]}
    camera = CAMERA | {"elevation": 0.6}
    scene = placed("primitive/cube", size=(33, 33), camera=camera, thing=thing, lights=light, floor=floor)
    seen = rasterise(scene).object_index
    need(bool((seen == 0).any() and (seen == 1).any()), "the cube or the floor is not seen")
    if context.current().software:
        need(PyrenderRenderer(scene).rasterises, "the rasteriser does not draw")
    return _against_formula(scene, Surface(0.5, 0.4, given=True), FLOOR)


def _default() -> Measured:
    """A file without a material's factors, and vertices of a colour."""
    scene = _scene({}, {"COLOR_0": np.tile([*BASE, 1.0], (3, 1))}, {})
    need(bool((scene.meshes[0].parts[0].color == 1).all()), "its factor is not white")
    return _against_formula(scene, Surface(1.0, 1.0, texel=BASE))


def _maps() -> Measured:
    """Metallic in blue, roughness in green, occlusion in red; base colour and emission in sRGB; alike all over."""

    def filled(*texel: int) -> Bytes:
        return np.full((4, 4, len(texel)), texel, np.uint8)

    material = _material(
        0.9,
        0.8,
        surface={"baseColorTexture": filled(188, 255, 128), "metallicRoughnessTexture": filled(7, 191, 102)},
        emissiveFactor=(0.5, 0.25, 1.0),
        emissiveTexture=filled(200, 188, 60),
        occlusionTexture={"image": filled(51, 0, 255), "strength": 0.75},
    )
    vertex = (1.0, 0.5, 0.25)
    texel = decoded([188, 255, 128]) * vertex
    emission = decoded([200, 188, 60]) * (0.5, 0.25, 1.0)
    surface = Surface(
        0.9 * 102 / 255,
        0.8 * 191 / 255,
        texel=(texel[0], texel[1], texel[2]),
        emission=(emission[0], emission[1], emission[2]),
        occlusion=1 + 0.75 * (51 / 255 - 1),
    )
    return _against_formula(_scene(material, {"COLOR_0": np.tile([*vertex, 1.0], (3, 1))}, {}), surface, TEXEL)


def _bent(
    axes: tuple[int, int],
    arrays: dict[str, Doubles] | None = None,
    thing: dict[str, Any] | None = None,
    **node: Any,
) -> Measured:
    """A normal map at half its scale. `axes`: directions of +u and of up in the texture, ±1 for x and ±2 for y."""
    more = {"normalTexture": {"image": BEND, "scale": 0.5}, "doubleSided": bool(thing)}
    bend = (BEND[0, 0] / 255 * 2 - 1) * (0.5, 0.5, 1.0)
    normal = np.array([0.0, 0.0, bend[2]])
    for axis, part in zip(axes, bend, strict=False):
        normal[abs(axis) - 1] = np.sign(axis) * part
    normal /= np.linalg.norm(normal)
    surface = Surface(0.2, 0.6, normal=(normal[0], normal[1], normal[2]))
    return _against_formula(_scene(_material(0.2, 0.6, **more), arrays or {}, thing or {}, **node), surface)


def _coverages(scene: ResolvedScene) -> list[float]:
    """The largest coverage of a pixel: in pyrender's images and the exact renderer's, and in the G-buffer."""
    renderer = PyrenderRenderer(scene)
    coverages = [float(variant.radiance({})[0, ..., 3].max()) for variant in (renderer, renderer.exact())]
    try:
        return [*coverages, float(rasterise(scene).coverage.max())]
    except InvalidRequest:  # nothing is in view
        return [*coverages, 0.0]


def _sides() -> Measured:
    """A single-sided face is invisible from behind, and a mirrored one is wholly visible from its front."""
    turned = _coverages(_scene(_material(0.2, 0.6), {}, {"rotation": (0.0, pi, 0.0)}))
    need(turned == [0, 0, 0], f"a back is seen, at coverages {turned}")
    mirrored = _scene(_material(0.2, 0.6), {}, {}, scale=(-1.0, 1.0, 1.0))
    need(_coverages(mirrored) == [1, 1, 1], "the front of a mirrored face is not seen")
    return _against_formula(mirrored, Surface(0.2, 0.6))


def _cut_out() -> Measured:
    """Within the outline, alpha at the cutoff is visible, however it is interpolated; below, not (glTF 2.0, 3.9.4)."""
    worst = 0.0
    for alpha, cutoff, coverage in ((1.0, 1.0, 1.0), (0.5, 0.5, 1.0), (0.49999, 0.5, 0.0)):
        surface = {"baseColorFactor": (*BASE, alpha)}
        scene = _scene(_material(0.2, 0.6, surface=surface, alphaMode="MASK", alphaCutoff=cutoff), {}, {})
        inner, renderer = expected(scene).pixels, PyrenderRenderer(scene)
        for variant in (renderer, renderer.exact()):
            worst = max(worst, largest(radiance_at(variant, inner)[1] - coverage))
    return Measured(worst, 0.0, "error of the coverage: 1 at the cutoff and 0 a hundred-thousandth below it")


def _blended() -> Measured:
    """A surface of opacity 0.4 has 0.4 of the formula's radiance, its emission included, and lets the ground through.

    Within its outline: on it Mesa's software renderer interpolates opacity to 0.5 %.
    """
    emission = (0.3, 0.2, 0.1)
    more = {"surface": {"baseColorFactor": (*BASE, 0.4)}, "alphaMode": "BLEND", "emissiveFactor": emission}
    scene = _scene(_material(0.2, 0.6, **more), {}, {})
    reference = expected(scene, shading=Surface(0.2, 0.6, emission=emission).radiance)
    ground, brightest = np.array(scene.description.ground), float(reference.radiance.max())
    renderer = PyrenderRenderer(scene)
    worst = 0.0
    for variant in (renderer, renderer.exact()):
        radiance, opacity = radiance_at(variant, reference.pixels)
        shown = variant.render({})[0].reshape(-1, 3)[reference.pixels].double().numpy()
        worst = max(worst, largest(radiance - 0.4 * reference.radiance) / brightest, largest(opacity - 0.4))
        worst = max(worst, largest(shown - (0.4 * reference.shown + 0.6 * ground)))
    seen = rasterise(scene).coverage.flatten()[reference.pixels].double().numpy()
    need(bool((np.abs(seen - 0.4) <= 1 / 16).all()), "the G-buffer's share of samples is not 0.4")
    return Measured(worst, FORMULA, f"error of radiance, coverage and displayed values; {len(reference.pixels)} pixels")


def _second_set() -> Measured:
    """The texture names the second set of coordinates; at those of the first it is black."""
    image = np.zeros((4, 8, 3), np.uint8)
    image[:, 4:] = (188, 255, 128)
    arrays = {"TEXCOORD_0": np.tile([0.25, 0.5], (3, 1)), "TEXCOORD_1": np.tile([0.75, 0.5], (3, 1))}
    surface = {"baseColorTexture": {"image": image, "texCoord": 1}}
    texel = decoded([188, 255, 128])
    expected_surface = Surface(0.2, 0.6, texel=(texel[0], texel[1], texel[2]))
    return _against_formula(_scene(_material(0.2, 0.6, surface=surface), arrays, {}), expected_surface, TEXEL)


def material_cases() -> Iterator[Case]:
    """The cases of this family."""
    formula, turned = "radiance and image by the formula", "the normal bends as the texture lies"
    stated = np.tile([0.0, 1.0, 0.0, -1.0], (3, 1))
    yield case("metal, roughness 0.3", "point, sun, spot and sky", formula, _plain, 1.0, 0.3)
    yield case("dielectric, roughness 0.8", "point, sun, spot and sky", formula, _plain, 0.0, 0.8)
    yield case("half metal, emissive", "every term at once", formula, _plain, 0.5, 0.55, emissiveFactor=(0.1, 0.2, 0.4))
    yield case("given metal, roughness 0.3", "a surface that the scene gives", formula, _given, 1.0, 0.3)
    yield case("given surfaces on a floor", "a floor behind the camera; the rasteriser too", formula, _floor)
    yield case("no factors", "the file's defaults", "white metal of roughness 1", _default)
    yield case("every map", "five maps and vertex colours", formula, _maps)
    yield case("second texture coordinates", "another set than the first", formula, _second_set)
    yield case("normal map", "u to the right", turned, _bent, (1, 2))
    yield case("normal map, mirrored texture", "u to the left", turned, _bent, (-1, 2), MIRRORED)
    yield case("normal map, mirrored node", "scale −1 along x", turned, _bent, (-1, 2), scale=(-1.0, 1.0, 1.0))
    back, over = "a double-sided face from behind", "the whole normal is turned over"
    yield case("normal map, on the back", back, over, _bent, (1, -2), thing={"rotation": (0.0, pi, 0.0)})
    yield case("normal map, stated tangent", "up, sign −1", turned, _bent, (2, 1), {"TANGENT": stated})
    yield case("backs and mirrors", "winding turned over", "fronts alone are seen", _sides)
    yield case("alpha at the cutoff", "1e-5 apart; alpha 1", "seen at it, not below it", _cut_out)
    yield case("blended", "opacity 0.4", "0.4 of the opaque surface", _blended)
