// Linear, unclamped radiance of a surface under light from all around and point lights. Exactly linear in `ambient` and
// in each of `intensities`. With base colour C, unit vectors n, v, l to the lights at distances d, up direction y:
//
//   C (ambient (1 + n.y / 3) + sum I n.l / (pi d^2))  +  ambient S(n.v)  +  sum I n.l / d^2 * D G F / (4 n.l n.v)
//
// A Lambertian body under a rough dielectric coat. The ambient light is a sky of radiance ambient * (1 + w.y / 2) in
// direction w, so that shapes show in the shade too. The coat is GGX (Walter et al. 2007) with height-correlated Smith
// shadowing and Schlick's Fresnel term F; S is F with its rise at grazing angles damped by the roughness.

const float ROUGHNESS = 0.45;        // alpha is its square
const float NORMAL_REFLECTANCE = 0.04;

uniform float ambient;
uniform vec3 positions[4];
uniform float intensities[4];

layout(location = 0) out vec4 radiance_and_opacity;  // radiance times opacity

float fresnel(float grazing, float cosine) {
    return NORMAL_REFLECTANCE + (grazing - NORMAL_REFLECTANCE) * pow(1.0 - clamp(cosine, 0.0, 1.0), 5.0);
}

float coat(vec3 n, vec3 v, vec3 l) {
    float a2 = pow(ROUGHNESS, 4.0);
    vec3 h = normalize(l + v);
    float nh = max(dot(n, h), 0.0), nl = max(dot(n, l), 0.0), nv = max(dot(n, v), 1e-4);
    float q = nh * nh * (a2 - 1.0) + 1.0;
    float distribution = a2 / (PI * q * q);
    // Smith's G over 4 (n.l)(n.v), in one.
    float visibility = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
    return distribution * visibility * fresnel(1.0, dot(v, h));
}

void main() {
    vec4 color = surface_color();
    vec3 v = normalize(eye - world_position);
    vec3 n = surface_normal(v);
    float body = ambient * (1.0 + n.y / 3.0);
    float gloss = ambient * fresnel(1.0 - ROUGHNESS, dot(n, v));
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
