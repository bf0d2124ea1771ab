// The formulas of shaders/surface.frag and shaders/radiance.frag for WIDTH fragments at once, in float32.

#pragma once

#include "coverage.h"

namespace {

inline Floats at_least(Floats a, float b) { return most<float>(a, Floats{} + b); }

struct Vector { Floats x, y, z; };
inline Vector vector(const Floats *of) { return {of[0], of[1], of[2]}; }
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator*(Vector a, Floats s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vector choose(Ints mask, Vector a, Vector b) {
    return {choose(mask, a.x, b.x), choose(mask, a.y, b.y), choose(mask, a.z, b.z)};
}
inline Floats dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector unit(Vector a) { return a * (1.0f / root<float>(dot(a, a))); }
inline Vector all(const float *v) { return {Floats{} + v[0], Floats{} + v[1], Floats{} + v[2]}; }

inline Floats fifth_power(Floats x) { return x * x * (x * x) * x; }

constexpr float PI = 3.14159265358979f, ROUGHNESS = 0.45f, NORMAL_REFLECTANCE = 0.04f;
constexpr float MIN_ROUGHNESS = 0.04f;  // of metallic-roughness surfaces
constexpr float A2 = ROUGHNESS * ROUGHNESS * ROUGHNESS * ROUGHNESS;

inline Floats fresnel(float grazing, Floats cosine) {
    const Floats x = at_least(1.0f - at_least(cosine, 0.0f), 0.0f);
    return NORMAL_REFLECTANCE + (grazing - NORMAL_REFLECTANCE) * (x * x * x * x * x);
}

inline Vector surface_normal(Vector n, Vector flat, Vector to_eye) {
    n = choose(dot(n, n) < 1e-12f, flat, n);
    n = choose(dot(n, flat) < 0.0f, n * (Floats{} - 1.0f), n);
    n = unit(n);
    const Floats facing = dot(n, to_eye);
    return choose(facing < 0.0f, unit(n - to_eye * facing), n);
}

inline Floats coat(Vector n, Vector v, Vector l) {
    const Vector h = unit(l + v);
    const Floats nh = at_least(dot(n, h), 0.0f), nl = at_least(dot(n, l), 0.0f), nv = at_least(dot(n, v), 1e-4f);
    const Floats q = nh * nh * (A2 - 1.0f) + 1.0f;
    const auto smith = [](Floats cosine) { return root<float>(cosine * cosine * (1.0f - A2) + A2); };
    const Floats visibility = 0.5f / (nl * smith(nv) + nv * smith(nl));
    return A2 / (PI * q * q) * visibility * fresnel(1.0f, dot(v, h));
}

struct BrdfTerms { Floats body, coat; };  // what the body reflects of each base colour, and what the coat adds to it

// In the light of an image of a pass.
inline BrdfTerms radiance(const Pass &pass, int64_t image, Vector position, Vector v, Vector n) {
    const float ambient = pass.ambients[image], *points = pass.points + 4 * pass.lights * image;
    BrdfTerms sum{ambient * (1.0f + n.y / 3.0f), ambient * fresnel(1.0f - ROUGHNESS, dot(n, v))};
    for (const float *point = points; point < points + 4 * pass.lights; point += 4) {
        const Vector to_light = all(point + 1) - position;
        const Floats distance2 = at_least(dot(to_light, to_light), 1e-6f);
        const Vector l = to_light * (1.0f / root<float>(distance2));
        const Floats irradiance = point[0] * at_least(dot(n, l), 0.0f) / distance2;
        sum.body += irradiance / PI;
        sum.coat += irradiance * coat(n, v, l);
    }
    return sum;
}

// The same of metallic-roughness surfaces that a scene gives (`image` and `reflected` of radiance.frag): base colours
// `color` to radiances.
inline void metallic_radiance(const Pass &pass, int64_t image, Vector position, Vector v, Vector n, Floats metallic,
                              Floats roughness, Floats *color) {
    const auto clamped = [](Floats x, float low) { return least<float>(at_least(x, low), Floats{} + 1.0f); };
    const Floats rough = at_least(roughness, MIN_ROUGHNESS), a2 = rough * rough * rough * rough;
    const Floats facing = dot(n, v), nv = most<float>(facing, -facing), seen = clamped(nv, 1e-3f);
    const Floats around = 1.0f + n.y / 3.0f, mirrored = 1.0f + (2.0f * facing * n.y - v.y) / 2.0f;
    const Floats rise = fifth_power(1.0f - clamped(nv, 0.0f)), ambient = Floats{} + pass.ambients[image];
    Floats body[3], f0[3];
    for (int c = 0; c < 3; ++c) {
        body[c] = color[c] * ((1.0f - metallic) * (1.0f - NORMAL_REFLECTANCE));
        f0[c] = NORMAL_REFLECTANCE * (1.0f - metallic) + color[c] * metallic;
        const Floats sheen = f0[c] + (most<float>(1.0f - rough, f0[c]) - f0[c]) * rise;
        const Floats sky = mirrored * (1.0f - rough) + around * rough;
        color[c] = ambient * ((1.0f - sheen) * body[c] * around + sheen * sky);
    }
    const float *points = pass.points + 4 * pass.lights * image;
    for (const float *point = points; point < points + 4 * pass.lights; point += 4) {
        const Vector to_light = all(point + 1) - position;
        const Floats distance2 = at_least(dot(to_light, to_light), 1e-6f);
        const Vector l = to_light * (1.0f / root<float>(distance2)), h = unit(l + v);
        const Floats nl = at_least(dot(n, l), 0.0f), nh = clamped(dot(n, h), 0.0f);
        const Floats q = nh * nh * (a2 - 1.0f) + 1.0f, irradiance = point[0] * nl / distance2;
        const auto smith = [&](Floats cosine) { return root<float>(cosine * cosine * (1.0f - a2) + a2); };
        const Floats visibility = 0.5f / (nl * smith(seen) + seen * smith(nl));
        const Floats gloss = a2 / (PI * q * q) * visibility, schlick = fifth_power(1.0f - clamped(dot(v, h), 0.0f));
        for (int c = 0; c < 3; ++c) {
            const Floats fresnel = f0[c] + (1.0f - f0[c]) * schlick;
            color[c] += irradiance * ((1.0f - fresnel) * body[c] / PI + fresnel * gloss);
        }
    }
}

}  // namespace
