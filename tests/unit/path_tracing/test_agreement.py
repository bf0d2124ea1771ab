"""Plain scenes against the pyrender renderer: camera, poses, colours, materials, textures, shadows and the floor."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scene_attack.scenes.description import DirectionalLight, Floor, Lights, PointLight, Scene, Shadows
from scene_attack.scenes.mesh import Mesh, Part, TextureMap
from scene_attack.scenes.resolve import with_surface_of_part
from tests.unit.path_tracing.agreement import MODEL, assert_agree, by_pyrender, images, inside, tracer, unmapped
from tests.unit.rendering import shapes

pytestmark = pytest.mark.slow


SUN = Lights(ambient=0.0, points=(), directional=(DirectionalLight(energy=3.0, direction=(-0.2, -0.5, -1.0)),))
LAMP = Lights(ambient=0.0, points=(PointLight(energy=9.0, position=(0.4, 0.6, 1.5)),))


def lopsided() -> Mesh:
    """Three slabs that no turn or mirror maps to each other."""
    slabs = [shapes.quad(0.3, 0.1, (0.1, 0.15, 0.0)), shapes.quad(0.05, 0.25, (-0.2, -0.1, 0.2))]
    return shapes.mesh(*slabs, shapes.quad(0.1, 0.02, (0.2, -0.3, -0.1)))


MOVED: list[dict[str, Any]] = [
    {},
    {"camera": [0.5, 0.3, 2.2, 0.0]},
    {"camera": [-0.7, -0.2, 1.6, 0.6]},
    {"translation": [[0.12, -0.08, 0.2]]},
    {"rotation": [[0.5, 0.2, -0.4]]},
]


@pytest.mark.parametrize("moved", MOVED, ids=str)
@pytest.mark.parametrize("size", [(64, 64), (48, 80)], ids=str)
def test_silhouettes_are_pyrender_s(name: str, moved: dict[str, Any], size: tuple[int, int]) -> None:
    """The coverage of a pixel at an edge has 512 samples here and 256 there, whose mean deviation is 0.03 at most. A
    silhouette that is a tenth of a pixel off is off by 0.1."""
    scene = shapes.placed(shapes.scene(size, lights=SUN), lopsided())
    own, theirs = images(tracer(name, scene), **moved)[:, ..., 3].mean(axis=0), by_pyrender(scene, **moved)[..., 3]
    edges = ((own > 0) & (own < 1)) | ((theirs > 0) & (theirs < 1))
    assert 30 < edges.sum() < theirs.size / 3
    assert not np.abs(own - theirs)[~edges].any()
    assert np.abs(own - theirs)[edges].mean() < 0.02
    assert abs((own - theirs)[edges].mean()) < 0.008


def glossy(part: Part, metallic: float, roughness: float, **settings: Any) -> Part:
    """The part with a glTF material."""
    surface = with_surface_of_part(part, metallic, roughness)
    assert surface.metallic_roughness is not None
    return replace(surface, metallic_roughness=replace(surface.metallic_roughness, **settings))


SURFACES: dict[str, tuple[Callable[[Part], Part], float]] = {
    "coated": (lambda part: part, 0.002),
    "plastic": (lambda part: glossy(part, 0.0, 0.6), 0.003),
    "smooth plastic": (lambda part: glossy(part, 0.0, 0.3), 0.008),
    "metal": (lambda part: glossy(part, 1.0, 0.5), 0.005),
    "half metal": (lambda part: glossy(part, 0.5, 0.5), 0.005),
}
"""Surfaces, and what is no disagreement, as a share of the brightest: in the highlights, of which pyrender has 64
samples in a pixel here, the more the sharper they are."""


@pytest.mark.parametrize("lights", [LAMP, SUN], ids=["lamp", "sun"])
@pytest.mark.parametrize("kind", SURFACES)
def test_a_surface_is_pyrender_s(name: str, kind: str, lights: Lights) -> None:
    surface, allowed = SURFACES[kind]
    colored = shapes.sphere(color=(0.8, 0.5, 0.2, 1.0))
    scene = shapes.placed(shapes.scene((48, 48), lights=lights), shapes.mesh(surface(colored)))
    changes = {"color": [[0.9, 0.6, 1.0]]}
    drawn, theirs = images(tracer(name, scene), **changes), by_pyrender(scene, **changes)
    where = inside(drawn[0, ..., 3], theirs[..., 3]) & (theirs[..., 0] > 0.05 * theirs[..., 0].max())
    assert_agree(drawn[..., :3], theirs[..., :3], max(allowed, MODEL[name]) * theirs[..., :3].max(), where)


def test_the_coat_is_pyrender_s_in_grazing_light(name: str) -> None:
    """A sun behind the sphere, whose light the coat mirrors at some 60°. Fresnel's term rises there: a dielectric's,
    which Mitsuba has, by a seventh more."""
    behind = Lights(ambient=0.0, points=(), directional=(DirectionalLight(energy=3.0, direction=(0.6, -0.6, 0.5)),))
    scene = shapes.placed(shapes.scene((64, 64), lights=behind), shapes.mesh(shapes.sphere(color=(0.0, 0.0, 0.0, 1.0))))
    drawn, theirs = images(tracer(name, scene, samples=256)), by_pyrender(scene)
    whole = inside(drawn[0, ..., 3], theirs[..., 3])
    where = whole & (theirs[..., 0] > 0.01 * theirs[whole][:, 0].max())
    mean, reference = drawn[..., 0].mean(axis=0)[where].mean(), theirs[..., 0][where].mean()
    assert where.sum() > 50
    assert mean == pytest.approx(reference, rel=0.01 if name == "blender" else 0.2)


TEXELS = np.kron(np.random.default_rng(0).integers(0, 256, (4, 4, 4), np.uint8), np.ones((8, 8, 1), np.uint8))
"""Sixteen squares of random colours, large enough that filters agree within them."""


def textured(kind: str, texels: np.ndarray) -> Part:
    """A square with a texture, as base colour of a part or of a glTF material."""
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    if kind == "part":
        return shapes.quad(0.6, texture=texels)
    square = shapes.quad(0.6, uv=uv)
    given = TextureMap(texels, int(kind == "second set"), (10497, 10497))
    return glossy(square, 0.0, 0.8, maps={"base_color": given}, second_uv=uv[:, ::-1].copy())


@pytest.mark.parametrize("kind", ["part", "material", "second set"])
def test_a_texture_lies_as_pyrender_s(name: str, kind: str) -> None:
    opaque = TEXELS.copy()
    opaque[..., 3] = 255
    scene = shapes.placed(shapes.scene((64, 64), lights=SUN), shapes.mesh(textured(kind, opaque)))
    drawn, theirs = images(tracer(name, scene)), by_pyrender(scene)
    assert_agree(drawn, theirs, (0.005 + MODEL[name]) * theirs.max(), even(theirs))


STEP = 1 / 64
"""A path passes a transparent surface or not, so that its coverage comes in steps of one in 64 samples, at which strata
hold it: it has less spread over seeds than it is off."""


def half_cut() -> Part:
    """A square whose left half is cut out, its texels having less than half alpha."""
    texels = np.full((32, 32, 4), 255, np.uint8)
    texels[:, :16, 3] = 100
    return shapes.quad(0.6, texture=texels)


def see_through() -> Part:
    return shapes.quad(0.6, color=(0.9, 0.5, 0.3, 0.3))


@pytest.mark.parametrize("surface", [half_cut, see_through])
def test_what_is_cut_out_or_transparent_covers_as_pyrender_s(name: str, surface: Callable[[], Part]) -> None:
    scene = shapes.placed(shapes.scene((48, 48), lights=SUN), shapes.mesh(surface()))
    own, theirs = tracer(name, scene), by_pyrender(scene)
    drawn = images(own)
    if "coats of transparent parts" in unmapped(own):
        drawn = np.concatenate([theirs[None, ..., :3].repeat(len(drawn), axis=0), drawn[..., 3:]], axis=-1)
    assert_agree(drawn, theirs, STEP + MODEL[name] * theirs.max(), even(theirs))


def even(image: np.ndarray) -> np.ndarray:
    """Pixels [H, W] around which an image [H, W, C] is nearly the same; at least a hundred of them are covered."""
    around = [np.roll(image, shift, axis) for shift in (-2, -1, 1, 2) for axis in (0, 1)]
    same = np.asarray(np.ptp(around, axis=0).max(axis=-1) < 0.01)
    assert (same & (image[..., 3] > 0.1)).sum() >= 100
    return same


@pytest.mark.parametrize(
    ("mode", "settings"),
    [
        ("MASK", {"alpha_mode": "MASK", "alpha_cutoff": 0.5}),
        ("BLEND", {"alpha_mode": "BLEND"}),
        ("OPAQUE", {"alpha_mode": "OPAQUE"}),
        ("culled backs", {"double_sided": False}),
        ("emission", {"emissive": (0.2, 0.4, 0.8)}),
    ],
)
def test_a_gltf_material_s_settings(name: str, mode: str, settings: dict[str, Any]) -> None:
    texels = np.full((32, 32, 4), 255, np.uint8)
    texels[:, :16, 3] = 100
    square = glossy(shapes.quad(0.6), 0.0, 0.8, maps={"base_color": TextureMap(texels, 0, (10497, 10497))}, **settings)
    away = replace(
        square, vertices=square.vertices * 0.5 + np.array([0, 0, 0.3], np.float32), faces=square.faces[:, ::-1]
    )
    parts = [square, away] if mode == "culled backs" else [square]
    scene = shapes.placed(shapes.scene((48, 48), lights=SUN), shapes.mesh(*parts))
    own, theirs = tracer(name, scene), by_pyrender(scene)
    drawn = images(own)
    if mode in unmapped(own):
        pytest.skip("the plan says that it is left out")
    assert_agree(drawn, theirs, max(STEP, (0.005 + MODEL[name]) * theirs.max()), even(theirs))


def floor_scene(shadows: Shadows | None, lights: Lights) -> Scene:
    description = shapes.scene((64, 64), lights=lights, elevation=0.5)
    return description.model_copy(update={"shadows": shadows, "floor": Floor(size=6.0, height=-0.3)})


MAPS = {"metallic_roughness": (0, 150, 200, 255), "normal": (180, 110, 230, 255), "emissive": (60, 120, 200, 255)}
"""Maps of one colour: of roughness in green and metallic in blue, of a normal that leans over, and of an emission."""


@pytest.mark.parametrize("kind", MAPS)
def test_a_gltf_map_s_channels(name: str, kind: str) -> None:
    """Their square's u grows to the right, as its tangent says to pyrender."""
    maps = {kind: TextureMap(np.full((4, 4, 4), MAPS[kind], np.uint8), 0, (10497, 10497))}
    tangents = np.tile(np.array([1, 0, 0, 1], np.float32), (4, 1))
    part = shapes.quad(0.6, color=(0.8, 0.5, 0.3, 1.0))
    square = glossy(
        part, 0.9, 0.8, maps=maps, tangents=tangents, emissive=(0.5, 0.5, 0.5) if kind == "emissive" else (0,) * 3
    )
    scene = shapes.placed(shapes.scene((48, 48), lights=SUN), shapes.mesh(square))
    own, theirs = tracer(name, scene), by_pyrender(scene)
    if f"{kind} maps" in unmapped(own):
        pytest.skip("the plan says that it is left out")
    drawn = images(own)
    assert_agree(drawn, theirs, 0.01 * theirs.max(), inside(drawn[0, ..., 3], theirs[..., 3]))


ASIDE = [
    Lights(ambient=0.0, points=(PointLight(energy=9.0, position=(1.2, 0.8, 0.3)),)),
    Lights(ambient=0.0, points=(), directional=(DirectionalLight(energy=3.0, direction=(-1.0, -0.7, -0.1)),)),
]


@pytest.mark.parametrize("lights", ASIDE, ids=["lamp", "sun"])
@pytest.mark.parametrize("shadows", [None, Shadows(softness=0.2, angle=0.08, resolution=2048, samples=64)])
def test_shadows_follow_the_scene(name: str, shadows: Shadows | None, lights: Lights) -> None:
    """On the floor, whose colour no group changes. Shadow maps are off at the edges of shadows, by some pixels."""
    scene = shapes.placed(floor_scene(shadows, lights), shapes.mesh(shapes.sphere(0.25)))
    own, theirs = tracer(name, scene), by_pyrender(scene)
    drawn = images(own)
    if "lights without shadows" in unmapped(own):
        pytest.skip("the plan says that it is left out")
    whole = inside(drawn[0, ..., 3], theirs[..., 3])
    error = np.abs(drawn[..., :3].mean(axis=0) - theirs[..., :3]).max(axis=-1)[whole] / theirs[..., :3].max()
    assert np.quantile(error, 0.9) < 0.005
    assert error.mean() < 0.003, "0.012 or more where shadows are missing, or cast although none are asked for"
