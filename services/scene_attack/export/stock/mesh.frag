#version 330 core

// For pyrender, in place of its own mesh.frag: the shading of the exported image, which glTF has no words for. Writes
// linear radiance after exposure, and opacity; render_exported.py reads them as floats and applies the display curve.
//
// With base colour C, unit vectors n, v, l to the lights at distances d, up direction y, BRDF 0 ("coat") is
//   C (ambient (1 + n.y / 3) + sum I n.l / (pi d^2))  +  ambient S(n.v)  +  sum I n.l / d^2 * D G F / (4 n.l n.v):
// a Lambertian body under a GGX coat with height-correlated Smith shadowing and Schlick's Fresnel term F; S is F with
// its rise at grazing angles damped by the roughness. BRDFs 1 and 2 are glTF's metallic-roughness, with Schlick's
// approximation of the shadowing ("gltf") or Smith's, height-correlated ("gltf-smith").

struct PointLight { vec3 color; float intensity; float range; vec3 position; };
struct DirectionalLight { vec3 color; float intensity; vec3 direction; };
struct SpotLight {
    vec3 color; float intensity; float range; vec3 position; vec3 direction;
    float light_angle_scale; float light_angle_offset;
};
struct Material {
    vec3 emissive_factor;
    vec4 base_color_factor;
    float metallic_factor;
    float roughness_factor;
#ifdef HAS_NORMAL_TEX
    sampler2D normal_texture;
#endif
#ifdef HAS_OCCLUSION_TEX
    sampler2D occlusion_texture;
#endif
#ifdef HAS_EMISSIVE_TEX
    sampler2D emissive_texture;
#endif
#ifdef HAS_BASE_COLOR_TEX
    sampler2D base_color_texture;
#endif
#ifdef HAS_METALLIC_ROUGHNESS_TEX
    sampler2D metallic_roughness_texture;
#endif
};

uniform Material material;
uniform PointLight point_lights[MAX_POINT_LIGHTS];
uniform DirectionalLight directional_lights[MAX_DIRECTIONAL_LIGHTS];
uniform SpotLight spot_lights[MAX_SPOT_LIGHTS];
uniform int n_point_lights;
uniform int n_directional_lights;
uniform int n_spot_lights;
uniform vec3 cam_pos;
uniform vec3 ambient_light;
uniform int coverage_only;   // 1: write 1 in place of the radiance
uniform int brdf;
uniform float alpha_cutoff;  // below 0: there is none
uniform int blended;
uniform float normal_scale;
uniform float occlusion_strength;
uniform int base_color_uv;   // 1: TEXCOORD_1; likewise below
uniform int metallic_roughness_uv;
uniform int normal_uv;
uniform int occlusion_uv;
uniform int emissive_uv;

in vec3 world_position;
centroid in vec3 world_normal;
centroid in vec4 world_tangent;
in vec4 uvs;  // in the pixel's middle, as the mipmap needs it
centroid in vec4 vertex_color;
out vec4 frag_color;

const float PI = 3.14159265358979;
const float DIELECTRIC = 0.04;
const float MIN_ROUGHNESS = 0.04;
const float ROUNDING = 1e-6;  // interpolation takes an alpha that is the same at all vertices this far below it

vec2 uv(int set) { return set == 1 ? uvs.zw : uvs.xy; }
float fifth_power(float x) { return x * x * (x * x) * x; }

// Unit normal on the side of the viewer; the side is that of the flat triangle, whatever its winding.
vec3 surface_normal(vec3 to_eye) {
    vec3 flat_normal = cross(dFdx(world_position), dFdy(world_position));
    vec3 n = world_normal;
    if (dot(n, n) < 1e-12) n = flat_normal;
    if (dot(n, flat_normal) < 0.0) n = -n;
    n = normalize(n);
    float facing = dot(n, to_eye);
    if (facing < 0.0) n = normalize(n - facing * to_eye);
    return n;
}

vec3 mapped_normal(vec3 n) {
#ifdef HAS_NORMAL_TEX
    float side = dot(n, world_normal) < 0.0 ? -1.0 : 1.0;
    vec3 outwards = side * n;
    vec3 t = world_tangent.xyz - dot(world_tangent.xyz, outwards) * outwards;
    if (dot(t, t) < 1e-12) return n;
    t = normalize(t);
    vec3 b = (world_tangent.w < 0.0 ? -1.0 : 1.0) * cross(outwards, t);
    vec3 bend = 2.0 * texture(material.normal_texture, uv(normal_uv)).xyz - 1.0;
    vec3 bent = mat3(t, b, outwards) * (vec3(normal_scale, normal_scale, 1.0) * bend);
    return dot(bent, bent) < 1e-12 ? n : side * normalize(bent);
#else
    return n;
#endif
}

struct Surface { vec3 base; vec3 body; vec3 f0; float roughness; };

// The factors of the body's irradiance over pi, and what is reflected above it.
void reflected(Surface s, vec3 n, vec3 v, vec3 l, out vec3 body, out vec3 gloss) {
    float a2 = s.roughness * s.roughness * s.roughness * s.roughness;
    vec3 h = normalize(l + v);
    float nh = clamp(dot(n, h), 0.0, 1.0), nl = max(dot(n, l), 0.0);
    float nv = brdf == 0 ? max(dot(n, v), 1e-4) : clamp(abs(dot(n, v)), 1e-3, 1.0);
    float q = nh * nh * (a2 - 1.0) + 1.0;
    float distribution = a2 / (PI * q * q);
    float visibility;  // Smith's G over 4 (n.l)(n.v), in one
    if (brdf == 1) {
        float k = (s.roughness + 1.0) * (s.roughness + 1.0) / 8.0;
        visibility = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
    } else {
        visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
    }
    vec3 fresnel = s.f0 + (1.0 - s.f0) * fifth_power(1.0 - clamp(dot(v, h), 0.0, 1.0));
    body = brdf == 0 ? s.base : (1.0 - fresnel) * s.body;
    gloss = fresnel * (distribution * visibility);
}

void main() {
    vec4 color = vertex_color * material.base_color_factor;
#ifdef HAS_BASE_COLOR_TEX
    color *= texture(material.base_color_texture, uv(base_color_uv));  // sRGB, decoded before filtering
#endif
    if (alpha_cutoff >= 0.0 && color.a < alpha_cutoff - ROUNDING) discard;
    float opacity = blended == 1 ? color.a : 1.0;
    vec3 v = normalize(cam_pos - world_position);
    vec3 n = mapped_normal(surface_normal(v));
    float metallic = material.metallic_factor, roughness = material.roughness_factor, occlusion = 1.0;
#ifdef HAS_METALLIC_ROUGHNESS_TEX
    vec4 texel = texture(material.metallic_roughness_texture, uv(metallic_roughness_uv));
    roughness *= texel.g;
    metallic *= texel.b;
#endif
    roughness = max(roughness, MIN_ROUGHNESS);
#ifdef HAS_OCCLUSION_TEX
    occlusion += occlusion_strength * (texture(material.occlusion_texture, uv(occlusion_uv)).r - 1.0);
#endif
    vec3 emission = material.emissive_factor;
#ifdef HAS_EMISSIVE_TEX
    emission *= texture(material.emissive_texture, uv(emissive_uv)).rgb;
#endif
    Surface s = Surface(
        color.rgb, color.rgb * ((1.0 - metallic) * (1.0 - DIELECTRIC)), mix(vec3(DIELECTRIC), color.rgb, metallic),
        roughness
    );
    vec3 body = vec3(0.0), gloss = vec3(0.0), under, above, l;
    for (int i = 0; i < n_point_lights; ++i) {
        vec3 to_light = point_lights[i].position - world_position;
        float distance2 = max(dot(to_light, to_light), 1e-6);
        l = to_light * inversesqrt(distance2);
        float irradiance = point_lights[i].intensity * max(dot(n, l), 0.0) / distance2;
        reflected(s, n, v, l, under, above);
        body += irradiance / PI * under;
        gloss += irradiance * above;
    }
    for (int i = 0; i < n_directional_lights; ++i) {
        l = -normalize(directional_lights[i].direction);
        float irradiance = directional_lights[i].intensity * max(dot(n, l), 0.0);
        reflected(s, n, v, l, under, above);
        body += irradiance / PI * under;
        gloss += irradiance * above;
    }
    for (int i = 0; i < n_spot_lights; ++i) {
        vec3 to_light = spot_lights[i].position - world_position;
        float distance2 = max(dot(to_light, to_light), 1e-6);
        l = to_light * inversesqrt(distance2);
        float along = dot(-l, normalize(spot_lights[i].direction));
        float cone = clamp(spot_lights[i].light_angle_scale * along + spot_lights[i].light_angle_offset, 0.0, 1.0);
        float irradiance = spot_lights[i].intensity * cone * cone * max(dot(n, l), 0.0) / distance2;
        reflected(s, n, v, l, under, above);
        body += irradiance / PI * under;
        gloss += irradiance * above;
    }
    float around = 1.0 + n.y / 3.0, nv = clamp(abs(dot(n, v)), 0.0, 1.0);
    vec3 sheen = s.f0 + (max(vec3(1.0 - s.roughness), s.f0) - s.f0) * fifth_power(1.0 - nv);
    if (brdf == 0) {
        body += ambient_light * s.base * around;
        gloss += ambient_light * sheen;
    } else {
        float mirrored = 1.0 + reflect(-v, n).y / 2.0;
        gloss += ambient_light * occlusion * sheen * mix(mirrored, around, s.roughness);
        body += ambient_light * occlusion * (1.0 - sheen) * s.body * around;
    }
    // pyrender multiplies a blended colour by its opacity; the coat's gloss does not fade with the body.
    vec3 radiance = brdf == 0 ? body + gloss / max(opacity, 1e-4) : body + gloss + emission;
    frag_color = vec4(coverage_only == 1 ? vec3(1.0) : radiance, opacity);
}
