// Linear, unclamped radiance of a surface under uniform and point light. Exactly linear in `ambient` and `intensities`.
//
//   radiance = base * (ambient * sky(n) + sum_i I_i (n.l_i) / (pi d_i^2)) + sum_i I_i (n.l_i) / d_i^2 * D G F / (4 (n.l_i) (n.v))
//
// A Lambertian body under a thin dielectric coat: GGX distribution (Walter et al. 2007), height-correlated Smith
// shadowing, Schlick's Fresnel term.

const float ROUGHNESS = 0.45;        // alpha is its square
const float NORMAL_REFLECTANCE = 0.04;

uniform float ambient;
uniform vec3 positions[4];
uniform float intensities[4];

layout(location = 0) out vec4 radiance_and_opacity;  // radiance times opacity

float coat(vec3 n, vec3 v, vec3 l) {
    float a2 = pow(ROUGHNESS, 4.0);
    vec3 h = normalize(l + v);
    float nh = max(dot(n, h), 0.0), nl = max(dot(n, l), 0.0), nv = max(dot(n, v), 1e-4);
    float q = nh * nh * (a2 - 1.0) + 1.0;
    float distribution = a2 / (PI * q * q);
    // Smith's G over 4 (n.l)(n.v), in one.
    float visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
    float fresnel = NORMAL_REFLECTANCE + (1.0 - NORMAL_REFLECTANCE) * pow(1.0 - clamp(dot(v, h), 0.0, 1.0), 5.0);
    return distribution * visibility * fresnel;
}

void main() {
    vec4 color = surface_color();
    vec3 v = normalize(eye - world_position);
    vec3 n = surface_normal(v);
    float body = ambient;
    float gloss = 0.0;
    for (int i = 0; i < 4; ++i) {
        vec3 to_light = positions[i] - world_position;
        float distance2 = max(dot(to_light, to_light), 1e-6);
        vec3 l = to_light * inversesqrt(distance2);
        float irradiance = intensities[i] * max(dot(n, l), 0.0) / distance2;
        body += irradiance / PI;
        gloss += irradiance * coat(n, v, l);
    }
    radiance_and_opacity = vec4(color.rgb * color.a * body + gloss, color.a);
}
