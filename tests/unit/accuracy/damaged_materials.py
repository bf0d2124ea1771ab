"""Ways to break suns, spot lights and the materials of glTF files."""

from dataclasses import replace

import numpy as np

from services.accuracy import placing
from services.rendering.kernels import compiled
from services.rendering.pyrender_renderer import parameters, renderer
from services.scenes import resolve
from services.scenes.reading import gltf
from tests.unit.accuracy.damaged_shaders import shader

# light
straight_cone = shader("radiance.frag", "cone * cone / distance2", "cone / distance2")
spots_without_distance = shader("radiance.frag", "cone * cone / distance2", "cone * cone")


def suns_from_behind(patch) -> None:
    """A sun's light comes from where it goes."""
    true = parameters.SceneParameters.lit

    def lit(self, *given):
        drawn = true(self, *given)
        turned = drawn.directionals.copy()
        turned[..., 1:] *= -1
        return replace(drawn, directionals=turned)

    patch.setattr(parameters.SceneParameters, "lit", lit)


def no_inner_angle(patch) -> None:
    """Spot lights fall off from their axis on."""
    true = parameters.SceneParameters.lit

    def lit(self, *given):
        drawn = true(self, *given)
        spots = drawn.spots.copy()
        ends = -spots[..., 8] / spots[..., 7]
        spots[..., 7], spots[..., 8] = 1 / (1 - ends), -ends / (1 - ends)
        return replace(drawn, spots=spots)

    patch.setattr(parameters.SceneParameters, "lit", lit)


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


def files_own_surface(patch) -> None:
    """A given metallic and roughness are not used: neither of meshes by name or by their parts, nor of the floor."""

    def own(mesh, *_):
        return mesh

    for module in (resolve, placing):
        patch.setattr(module, "with_surface", own)


def rasteriser_without_metal(patch) -> None:
    """The rasteriser draws every surface as a Lambertian body under a coat, and nobody measures its error."""
    true = compiled.structure
    patch.setattr(compiled, "structure", lambda name, **fields: true(name, **_plain(fields)))
    patch.setattr(renderer.ImageError, "within", lambda *_: True)


def _plain(fields):
    return fields | {"metallic": -1.0} if "metallic" in fields else fields
