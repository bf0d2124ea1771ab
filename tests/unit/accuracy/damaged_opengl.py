"""Ways to break what OpenGL draws: a shader's text, changed at one place and compiled again; suns, spot lights and
materials on their way to it; shadow maps.

The rasteriser that stands in for OpenGL has code of its own, and is found out when it is compared with OpenGL.
"""

import atexit
import shutil
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender import parameters, renderer
from scene_attack.scenes import resolve
from scene_attack.scenes.reading import gltf
from scene_attack_accuracy import placing
from tests.unit.accuracy.damage import breaks

FOLDERS = mkdtemp(prefix="shaders-")
atexit.register(shutil.rmtree, FOLDERS, ignore_errors=True)


def shader(file: str, old: str, new: str):
    """Replaces `old` by `new` in a shader; there must be such a place."""

    def apply(patch) -> None:
        drawing = context.current().renderer
        from scene_attack.rendering.opengl import mesh_upload  # imports OpenGL, so after the context

        folder = Path(mkdtemp(dir=FOLDERS))
        for path in mesh_upload.SHADERS.iterdir():
            shutil.copy(path, folder)
        text = (folder / file).read_text()
        assert old in text, f"{file} has no {old!r}"
        (folder / file).write_text(text.replace(old, new))
        patch.setattr(mesh_upload, "SHADERS", folder)
        patch.setattr(drawing, "_programs", {})

    return apply


no_inverse_pi = shader("radiance.frag", "irradiance / PI", "irradiance")
inverse_distance = shader("radiance.frag", "/ distance2;", "* inversesqrt(distance2);")
no_gloss = shader("radiance.frag", "+ gloss, opacity", ", opacity")
flat_sky = shader("radiance.frag", "(1.0 + n.y / 3.0)", "1.0")
color_squared = shader("radiance.frag", "base_colors[k] * texel", "base_colors[k] * base_colors[k] * texel")
no_fresnel = shader("radiance.frag", "* fresnel(1.0, dot(v, h))", "* NORMAL_REFLECTANCE")
other_half_vector = shader("radiance.frag", "normalize(l + v)", "(0.5 * (l + v))")
light_on_both_sides = shader("radiance.frag", "max(dot(n, l), 0.0) / distance2", "abs(dot(n, l)) / distance2")
short_normals = shader("surface.frag", "n = normalize(n);", "")
texture_upside_down = shader("surface.frag", "texture_uv);", "vec2(texture_uv.x, 1.0 - texture_uv.y));")
texture_mirrored = shader("surface.frag", "texture_uv);", "vec2(1.0 - texture_uv.x, texture_uv.y));")
texture_not_repeated = shader("surface.frag", "texture_uv);", "clamp(texture_uv, 0.001, 0.999));")
texture_as_displayed = shader("surface.frag", "return texel.rgb;", "return pow(texel.rgb, vec3(1.0 / 2.2));")
other_texture_curve = shader("surface.frag", "return texel.rgb;", "return pow(texel.rgb, vec3(2.2 / 2.4));")
holes_everywhere = shader("surface.frag", "texel.a < 0.5", "texel.a > 0.5")


# light
straight_cone = shader("radiance.frag", "cone * cone / distance2", "cone / distance2")
spots_without_distance = shader("radiance.frag", "cone * cone / distance2", "cone * cone")


@breaks("lit", parameters.SceneParameters)
def suns_from_behind(true, self, *given):
    """A sun's light comes from where it goes."""
    drawn = true(self, *given)
    turned = drawn.directionals.copy()
    turned[..., 1:] *= -1
    return replace(drawn, directionals=turned)


@breaks("lit", parameters.SceneParameters)
def no_inner_angle(true, self, *given):
    """Spot lights fall off from their axis on."""
    drawn = true(self, *given)
    spots = drawn.spots.copy()
    ends = -spots[..., 8] / spots[..., 7]
    spots[..., 7], spots[..., 8] = 1 / (1 - ends), -ends / (1 - ends)
    return replace(drawn, spots=spots)


# the BRDF
rough_alpha = shader(
    "radiance.frag", "float a2 = m.roughness * m.roughness * m.roughness", "float a2 = m.roughness * m.roughness"
)
other_shadowing = shader("radiance.frag", "(m.roughness + 1.0) * (m.roughness + 1.0) / 8.0", "0.5 * m.roughness")
metal_with_a_body = shader("radiance.frag", "(1.0 - m.metallic) * (1.0 - NORMAL", "(1.0 - NORMAL")
white_metal = shader("radiance.frag", "mix(vec3(NORMAL_REFLECTANCE), base", "mix(vec3(NORMAL_REFLECTANCE), vec3(1.0)")
sky_not_mirrored = shader("radiance.frag", "mix(mirrored, around, m.roughness)", "around")
colored_emission = shader("radiance.frag", "= m.emission +", "= m.emission * base_colors[k] +")
hidden_emission = shader("radiance.frag", "= m.emission +", "= m.emission * m.occlusion +")
no_emission = shader("radiance.frag", "= m.emission +", "= vec3(0.0) +")
occluded_lights = shader("radiance.frag", "m.occlusion * ambient;", "ambient; body *= m.occlusion; f0 *= m.occlusion;")
rougher = shader("metallic_roughness.frag", "MIN_ROUGHNESS = 0.04", "MIN_ROUGHNESS = 0.4")
emission_through = shader("radiance.frag", "radiance * m.alpha", "radiance * m.alpha + m.emission * (1.0 - m.alpha)")
opaque_blends = shader("metallic_roughness.frag", "m.alpha = base.a;", "")

# maps
file_upside_down = shader(
    "metallic_roughness.frag",
    "texture(base_color_map, UV(BASE_COLOR_MAP))",
    "texture(base_color_map, vec2(UV(BASE_COLOR_MAP).x, 1.0 - UV(BASE_COLOR_MAP).y))",
)
channels_exchanged = shader(
    "metallic_roughness.frag", "*= texel.g;\n    m.metallic *= texel.b", "*= texel.b;\n    m.metallic *= texel.g"
)
full_occlusion = shader("metallic_roughness.frag", "+= occlusion_strength *", "+=")
decoded_twice = shader("metallic_roughness.frag", "return m;", "m.texel = pow(m.texel, vec3(2.2)); return m;")
no_vertex_colors = shader("metallic_roughness.frag", "vec4(vertex_color.rgb, vertex_color.a * opacity)", "vec4(1.0)")
first_coordinates = shader(
    "metallic_roughness.frag", "((set) == 2 ? texture_uvs.zw : texture_uvs.xy)", "(texture_uvs.xy)"
)
cut_at_cutoff = shader("metallic_roughness.frag", "base.a < alpha_cutoff - ROUNDING", "base.a <= alpha_cutoff")
fixed_cutoff = shader("metallic_roughness.frag", "base.a < alpha_cutoff - ROUNDING", "base.a < 0.4")


emission_as_it_is = shader(
    "metallic_roughness.frag",
    "texture(emissive_map, UV(EMISSIVE_MAP)).rgb",
    "pow(texture(emissive_map, UV(EMISSIVE_MAP)).rgb, vec3(1.0 / 2.2))",
)

# normals
green_flipped = shader(
    "metallic_roughness.frag", "NORMAL_MAP)).xyz - 1.0;", "NORMAL_MAP)).xyz - 1.0; bend.y = -bend.y;"
)
full_bend = shader("metallic_roughness.frag", "vec3(normal_scale, normal_scale, 1.0)", "vec3(1.0)")
right_handed = shader("metallic_roughness.frag", "(world_tangent.w < 0.0 ? -1.0 : 1.0)", "1.0")
backs_bent_forwards = shader("metallic_roughness.frag", "side * normalize(bent)", "normalize(bent)")


def unseen_mirrors(patch) -> None:
    """Mirrored nodes keep their winding."""
    true = np.linalg.det
    patch.setattr(np.linalg, "det", lambda matrix: abs(true(matrix)))


def all_double_sided(patch) -> None:
    true = gltf.read_material
    patch.setattr(gltf, "read_material", lambda *given: replace(true(*given), double_sided=True))


# what a scene gives
files_shadowing = shader("radiance.frag", "#if GIVEN", "#if 0")


@breaks("with_surface", resolve, placing)
def files_own_surface(_true, mesh, *_):
    """A given metallic and roughness are not used: neither of meshes by name or by their parts, nor of the floor."""
    return mesh


def rasteriser_without_metal(patch) -> None:
    """The rasteriser draws every surface as a Lambertian body under a coat, and nobody measures its error."""
    true = compiled.structure
    patch.setattr(compiled, "structure", lambda name, **fields: true(name, **_plain(fields)))
    patch.setattr(renderer.ImageError, "within", lambda *_: True)


def _plain(fields):
    return fields | {"metallic": -1.0} if "metallic" in fields else fields


def _patched(name: str, value):
    def apply(patch) -> None:
        context.current()  # before what imports OpenGL
        from scene_attack.rendering.opengl import shadow_maps

        patch.setattr(shadow_maps, name, value)

    return apply


no_maps = _patched("shadow_views", lambda _corners, _light: [])
no_casters = _patched("casters", lambda _corners, _plain, _light: [])


def too_near(patch) -> None:
    """Every depth is taken for half as large, and everything is in the maps, the ground too."""
    context.current()
    from scene_attack.rendering.opengl import shadow_maps
    from scene_attack.rendering.opengl.shadows import ShadowView

    row = ShadowView.row.fget
    patch.setattr(ShadowView, "row", property(lambda view: row(view) * np.array([1, 1, 1, 1.0]) * _half()))
    patch.setattr(shadow_maps, "casters", lambda corners, _plain, _light: list(range(len(corners))))


def _half() -> np.ndarray:
    factors = np.ones((4, 4))
    factors[2, 3] = 0.5  # the depth that 1 stands for
    return factors


def rays_miss(patch) -> None:
    """No triangle stops a ray."""
    from scene_attack.rendering.torch import surfaces

    casters = surfaces.casters
    patch.setattr(surfaces, "casters", lambda scene: tuple(of[:2] for of in casters(scene)))
