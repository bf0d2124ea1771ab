// Linear, unclamped radiance of a surface under light from all around and point, directional and spot lights. Exactly
// linear in an image's ambient light and in each of its intensities, but for what a surface emits. With base colour C,
// unit vectors n, v, l to the lights at distances d, up direction y:
//
//   C (ambient (1 + n.y / 3) + sum I n.l / (pi d^2))  +  ambient S(n.v)  +  sum I n.l / d^2 * D G F / (4 n.l n.v)
//
// A Lambertian body under a rough dielectric coat. The ambient light is a sky of radiance ambient * (1 + w.y / 2) in
// direction w, so that shapes show in the shade too. The coat is GGX (Walter et al. 2007) with height-correlated Smith
// shadowing and Schlick's Fresnel term F; S is F with its rise at grazing angles damped by the roughness. In place of
// I / d^2, a directional light has its irradiance, and a spot light I / d^2 times its cone's fall-off.
//
// A glTF material has another BRDF, pyrender's; see `reflected`.

#if !SHADOWS
#define POINT_SEEN(i) 1.0
#define DIRECTIONAL_SEEN(i) 1.0
#define SPOT_SEEN(i) 1.0
#endif

const float ROUGHNESS = 0.45;        // alpha is its square
const float NORMAL_REFLECTANCE = 0.04;

uniform float ambients[IMAGES];
#if LIGHTS
uniform vec3 positions[IMAGES * LIGHTS];
uniform float intensities[IMAGES * LIGHTS];
#endif
#if DIRECTIONAL_LIGHTS
uniform vec3 to_suns[IMAGES * DIRECTIONAL_LIGHTS];  // unit vectors towards the lights
uniform float irradiances[IMAGES * DIRECTIONAL_LIGHTS];
#endif
#if SPOT_LIGHTS
uniform vec3 spot_positions[IMAGES * SPOT_LIGHTS];
uniform vec3 spot_directions[IMAGES * SPOT_LIGHTS];  // unit vectors along the axes
uniform float spot_intensities[IMAGES * SPOT_LIGHTS];
uniform float spot_scales[IMAGES * SPOT_LIGHTS];  // the fall-off is the square of scale cos(angle) + offset, clamped
uniform float spot_offsets[IMAGES * SPOT_LIGHTS];
#endif

// Radiance times opacity, and opacity. Invariant: an image has the same bits beside any others.
invariant layout(location = 0) out vec4 images[IMAGES];

float fifth_power(float x) {
    return x * x * (x * x) * x;
}

float fresnel(float grazing, float cosine) {
    return NORMAL_REFLECTANCE + (grazing - NORMAL_REFLECTANCE) * fifth_power(1.0 - clamp(cosine, 0.0, 1.0));
}

float coat(vec3 n, vec3 v, vec3 l) {
    const float a2 = ROUGHNESS * ROUGHNESS * ROUGHNESS * ROUGHNESS;
    vec3 h = normalize(l + v);
    float nh = max(dot(n, h), 0.0), nl = max(dot(n, l), 0.0), nv = max(dot(n, v), 1e-4);
    float q = nh * nh * (a2 - 1.0) + 1.0;
    float distribution = a2 / (PI * q * q);
    // Smith's G over 4 (n.l)(n.v), in one.
    float visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
    return distribution * visibility * fresnel(1.0, dot(v, h));
}

#if SPOT_LIGHTS
// Irradiance of a surface here that faces spot light i, and the direction to it.
float spot_irradiance(int i, out vec3 l) {
    vec3 to_light = spot_positions[i] - world_position;
    float distance2 = max(dot(to_light, to_light), 1e-6);
    l = to_light * inversesqrt(distance2);
    float cone = clamp(spot_scales[i] * dot(-l, spot_directions[i]) + spot_offsets[i], 0.0, 1.0);
    return spot_intensities[i] * cone * cone / distance2;
}
#endif

#if METALLIC_ROUGHNESS
// pyrender's BRDF, 1/sr: a diffuse body of (1 - F) C (1 - metallic) (1 - 0.04) / pi under GGX reflection, with Schlick's
// F from f0 = mix(0.04, C, metallic), alpha = roughness^2, and Schlick's approximation of Smith's shadowing with
// k = (roughness + 1)^2 / 8 (Karis 2013). Where a scene gives the surface, the shadowing is glTF's own, as the coat's:
// Smith's, height-correlated (Heitz 2014). The approximation is up to a third too dark on smooth metals.
vec3 reflected(Material m, vec3 body, vec3 f0, vec3 n, vec3 v, vec3 l) {
    float a2 = m.roughness * m.roughness * m.roughness * m.roughness;
    vec3 h = normalize(l + v);
    float nh = clamp(dot(n, h), 0.0, 1.0), nl = max(dot(n, l), 0.0), nv = clamp(abs(dot(n, v)), 1e-3, 1.0);
    float q = nh * nh * (a2 - 1.0) + 1.0;
    float distribution = a2 / (PI * q * q);
    // G over 4 (n.l)(n.v), in one.
#if GIVEN
    float visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
#else
    float k = (m.roughness + 1.0) * (m.roughness + 1.0) / 8.0;
    float visibility = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
#endif
    vec3 fresnel = f0 + (1.0 - f0) * fifth_power(1.0 - clamp(dot(v, h), 0.0, 1.0));
    return (1.0 - fresnel) * body / PI + fresnel * (distribution * visibility);
}

// Radiance of a glTF material. Of the ambient sky, a rough surface sees its cosine-weighted mean and a smooth one what
// it mirrors; the occlusion map darkens the ambient light alone.
vec4 image(int k, Material m, vec3 v, vec3 n) {
    vec3 base = base_colors[k] * m.texel;
    vec3 body = base * ((1.0 - m.metallic) * (1.0 - NORMAL_REFLECTANCE));
    vec3 f0 = mix(vec3(NORMAL_REFLECTANCE), base, m.metallic);
    vec3 rim = max(vec3(1.0 - m.roughness), f0) - f0;
    vec3 sheen = f0 + rim * fifth_power(1.0 - clamp(abs(dot(n, v)), 0.0, 1.0));
    float around = 1.0 + n.y / 3.0, mirrored = 1.0 + reflect(-v, n).y / 2.0;
    vec3 ambient = (1.0 - sheen) * body * around + sheen * mix(mirrored, around, m.roughness);
    vec3 radiance = m.emission + ambients[k] * m.occlusion * ambient;
#if LIGHTS
    for (int i = k * LIGHTS; i < (k + 1) * LIGHTS; ++i) {
        vec3 to_light = positions[i] - world_position;
        float distance2 = max(dot(to_light, to_light), 1e-6);
        vec3 l = to_light * inversesqrt(distance2);
        float irradiance = POINT_SEEN(i) * intensities[i] * max(dot(n, l), 0.0) / distance2;
        radiance += irradiance * reflected(m, body, f0, n, v, l);
    }
#endif
#if DIRECTIONAL_LIGHTS
    for (int i = k * DIRECTIONAL_LIGHTS; i < (k + 1) * DIRECTIONAL_LIGHTS; ++i) {
        vec3 l = to_suns[i];
        radiance += DIRECTIONAL_SEEN(i) * irradiances[i] * max(dot(n, l), 0.0) * reflected(m, body, f0, n, v, l);
    }
#endif
#if SPOT_LIGHTS
    for (int i = k * SPOT_LIGHTS; i < (k + 1) * SPOT_LIGHTS; ++i) {
        vec3 l;
        float irradiance = SPOT_SEEN(i) * spot_irradiance(i, l) * max(dot(n, l), 0.0);
        radiance += irradiance * reflected(m, body, f0, n, v, l);
    }
#endif
    return vec4(radiance * m.alpha, m.alpha);
}
#else
vec4 image(int k, vec3 texel, vec3 v, vec3 n) {
    float body = ambients[k] * (1.0 + n.y / 3.0);
    float gloss = ambients[k] * fresnel(1.0 - ROUGHNESS, dot(n, v));
#if LIGHTS
    for (int i = k * LIGHTS; i < (k + 1) * LIGHTS; ++i) {
        vec3 to_light = positions[i] - world_position;
        float distance2 = max(dot(to_light, to_light), 1e-6);
        vec3 l = to_light * inversesqrt(distance2);
        float irradiance = POINT_SEEN(i) * intensities[i] * max(dot(n, l), 0.0) / distance2;
        body += irradiance / PI;
        gloss += irradiance * coat(n, v, l);
    }
#endif
#if DIRECTIONAL_LIGHTS
    for (int i = k * DIRECTIONAL_LIGHTS; i < (k + 1) * DIRECTIONAL_LIGHTS; ++i) {
        vec3 l = to_suns[i];
        float irradiance = DIRECTIONAL_SEEN(i) * irradiances[i] * max(dot(n, l), 0.0);
        body += irradiance / PI;
        gloss += irradiance * coat(n, v, l);
    }
#endif
#if SPOT_LIGHTS
    for (int i = k * SPOT_LIGHTS; i < (k + 1) * SPOT_LIGHTS; ++i) {
        vec3 l;
        float irradiance = SPOT_SEEN(i) * spot_irradiance(i, l) * max(dot(n, l), 0.0);
        body += irradiance / PI;
        gloss += irradiance * coat(n, v, l);
    }
#endif
    return vec4(base_colors[k] * texel * opacity * body + gloss, opacity);
}
#endif

void main() {
    vec3 v = normalize(eye - world_position);
#if METALLIC_ROUGHNESS
    vec3 n = mapped_normal(surface_normal(v));
    Material surface = surface_material();
#else
    vec3 surface = surface_texel();
    vec3 n = surface_normal(v);
#endif
#if SHADOWS
    find_shadows(n);
#endif
    // Written out: a loop of this size stays a loop, and takes twice as long.
    images[0] = image(0, surface, v, n);
#if IMAGES > 1
    images[1] = image(1, surface, v, n);
#endif
#if IMAGES > 2
    images[2] = image(2, surface, v, n);
#endif
#if IMAGES > 3
    images[3] = image(3, surface, v, n);
#endif
#if IMAGES > 4
    images[4] = image(4, surface, v, n);
#endif
#if IMAGES > 5
    images[5] = image(5, surface, v, n);
#endif
#if IMAGES > 6
    images[6] = image(6, surface, v, n);
#endif
#if IMAGES > 7
    images[7] = image(7, surface, v, n);
#endif
}
