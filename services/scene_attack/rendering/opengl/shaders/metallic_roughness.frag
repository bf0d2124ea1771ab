// A glTF 2.0 metallic-roughness material at a fragment. Joined behind `surface.frag` by `Program`.
//
// Compiled for: ALPHA_MODE (0 OPAQUE, 1 MASK, 2 BLEND), GIVEN (1: a scene gives metallic and roughness) and, for each of its maps, the set of texture coordinates that it
// is laid out in: BASE_COLOR_MAP, METALLIC_ROUGHNESS_MAP, NORMAL_MAP, OCCLUSION_MAP, EMISSIVE_MAP (0: there is no map,
// 1: TEXCOORD_0, 2: TEXCOORD_1).

in vec4 texture_uvs;    // both sets
centroid in vec4 vertex_color;   // linear
centroid in vec4 world_tangent;  // along growing u, and the sign of the bitangent

uniform float alpha_cutoff;
uniform float metallic;
uniform float roughness;
uniform vec3 emissive;
uniform float normal_scale;
uniform float occlusion_strength;
uniform sampler2D base_color_map;          // sRGB, decoded before filtering
uniform sampler2D metallic_roughness_map;  // roughness in green, metallic in blue
uniform sampler2D normal_map;
uniform sampler2D occlusion_map;
uniform sampler2D emissive_map;            // sRGB

#define UV(set) ((set) == 2 ? texture_uvs.zw : texture_uvs.xy)

const float ROUNDING = 1e-6;  // interpolation takes an alpha that is the same at all vertices this far below it, or less
const float MIN_ROUGHNESS = 0.04;  // as pyrender: the highlight of a smoother surface would fall between the pixels

struct Material {
    vec3 texel;    // base colour, but for the factor of the image
    float alpha;
    float metallic;
    float roughness;
    vec3 emission;
    float occlusion;
};

// The material, or no fragment where a MASK cuts it out.
Material surface_material() {
    vec4 base = vec4(vertex_color.rgb, vertex_color.a * opacity);
#if BASE_COLOR_MAP
    base *= texture(base_color_map, UV(BASE_COLOR_MAP));
#endif
    Material m = Material(base.rgb, 1.0, metallic, roughness, emissive, 1.0);
#if METALLIC_ROUGHNESS_MAP
    vec4 texel = texture(metallic_roughness_map, UV(METALLIC_ROUGHNESS_MAP));
    m.roughness *= texel.g;
    m.metallic *= texel.b;
#endif
    m.roughness = max(m.roughness, MIN_ROUGHNESS);
#if OCCLUSION_MAP
    m.occlusion += occlusion_strength * (texture(occlusion_map, UV(OCCLUSION_MAP)).r - 1.0);
#endif
#if EMISSIVE_MAP
    m.emission *= texture(emissive_map, UV(EMISSIVE_MAP)).rgb;
#endif
#if ALPHA_MODE == 1
    if (base.a < alpha_cutoff - ROUNDING) discard;
#elif ALPHA_MODE == 2
    m.alpha = base.a;
#endif
    return m;
}

// The normal n of `surface_normal` bent by the normal map. On the back of a triangle all of it points the other way.
vec3 mapped_normal(vec3 n) {
#if NORMAL_MAP
    float side = dot(n, world_normal) < 0.0 ? -1.0 : 1.0;
    vec3 outwards = side * n;
    vec3 t = world_tangent.xyz - dot(world_tangent.xyz, outwards) * outwards;
    if (dot(t, t) < 1e-12) return n;
    t = normalize(t);
    vec3 b = (world_tangent.w < 0.0 ? -1.0 : 1.0) * cross(outwards, t);
    vec3 bend = 2.0 * texture(normal_map, UV(NORMAL_MAP)).xyz - 1.0;
    vec3 bent = mat3(t, b, outwards) * (vec3(normal_scale, normal_scale, 1.0) * bend);
    if (dot(bent, bent) < 1e-12) return n;
    return side * normalize(bent);
#else
    return n;
#endif
}
