// Linear, unclamped radiance of a surface under light from all around and point lights. Exactly linear in a
// picture's ambient light and in each of its intensities. With base colour C, unit vectors n, v, l to the lights at
// distances d, up direction y:
//
//   C (ambient (1 + n.y / 3) + sum I n.l / (pi d^2))  +  ambient S(n.v)  +  sum I n.l / d^2 * D G F / (4 n.l n.v)
//
// A Lambertian body under a rough dielectric coat. The ambient light is a sky of radiance ambient * (1 + w.y / 2) in
// direction w, so that shapes show in the shade too. The coat is GGX (Walter et al. 2007) with height-correlated Smith
// shadowing and Schlick's Fresnel term F; S is F with its rise at grazing angles damped by the roughness.

const float ROUGHNESS = 0.45;        // alpha is its square
const float NORMAL_REFLECTANCE = 0.04;

uniform float ambients[PICTURES];
#if LIGHTS
uniform vec3 positions[PICTURES * LIGHTS];
uniform float intensities[PICTURES * LIGHTS];
#endif

// Radiance times opacity, and opacity. Invariant: a picture has the same bits beside any others.
invariant layout(location = 0) out vec4 pictures[PICTURES];

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

vec4 picture(int k, vec3 texel, vec3 v, vec3 n) {
    float body = ambients[k] * (1.0 + n.y / 3.0);
    float gloss = ambients[k] * fresnel(1.0 - ROUGHNESS, dot(n, v));
#if LIGHTS
    for (int i = k * LIGHTS; i < (k + 1) * LIGHTS; ++i) {
        vec3 to_light = positions[i] - world_position;
        float distance2 = max(dot(to_light, to_light), 1e-6);
        vec3 l = to_light * inversesqrt(distance2);
        float irradiance = intensities[i] * max(dot(n, l), 0.0) / distance2;
        body += irradiance / PI;
        gloss += irradiance * coat(n, v, l);
    }
#endif
    return vec4(base_colors[k] * texel * opacity * body + gloss, opacity);
}

void main() {
    vec3 texel = surface_texel();
    vec3 v = normalize(eye - world_position);
    vec3 n = surface_normal(v);
    // Written out: a loop of this size stays a loop, and takes twice as long.
    pictures[0] = picture(0, texel, v, n);
#if PICTURES > 1
    pictures[1] = picture(1, texel, v, n);
#endif
#if PICTURES > 2
    pictures[2] = picture(2, texel, v, n);
#endif
#if PICTURES > 3
    pictures[3] = picture(3, texel, v, n);
#endif
#if PICTURES > 4
    pictures[4] = picture(4, texel, v, n);
#endif
#if PICTURES > 5
    pictures[5] = picture(5, texel, v, n);
#endif
#if PICTURES > 6
    pictures[6] = picture(6, texel, v, n);
#endif
#if PICTURES > 7
    pictures[7] = picture(7, texel, v, n);
#endif
}
