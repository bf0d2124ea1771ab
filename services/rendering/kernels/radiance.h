// shaders/surface.frag and shaders/radiance.frag for many fragments at once, operation for operation as the driver
// compiles them: float32, sums from the last component to the first, nothing fused, so that no bit differs.

#pragma once

#include "fuse.h"

namespace {

inline Floats at_least(Floats a, float b) { return choose(a > b, a, Floats{} + b); }
inline Floats at_most(Floats a, float b) { return choose(a < b, a, Floats{} + b); }
inline Floats root(Floats a) {
    Floats r;
    for (int i = 0; i < WIDTH; ++i) r[i] = std::sqrt(a[i]);
    return r;
}

struct Vector {
    Floats x, y, z;
};

inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator*(Vector a, Floats s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vector choose(Ints mask, Vector a, Vector b) {
    return {choose(mask, a.x, b.x), choose(mask, a.y, b.y), choose(mask, a.z, b.z)};
}
inline Floats dot(Vector a, Vector b) { return (a.z * b.z + a.y * b.y) + a.x * b.x; }
inline Vector unit(Vector a) { return a * (1.0f / root(dot(a, a))); }
inline Vector cross(Vector a, Vector b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class T> inline Vector all(const T *v) {
    return {Floats{} + float(v[0]), Floats{} + float(v[1]), Floats{} + float(v[2])};
}

// What a picture is lit by, and the linear factors on the base colours: see the shader's uniforms.
struct Light {
    float ambient;
    const float *points;  // [lights, 4]: intensity, position
    int64_t lights;
};

constexpr float PI = 3.14159265358979f, GRAZING = 0.55f, ROUGHNESS = 0.45f, NORMAL_REFLECTANCE = 0.04f;
constexpr float A2 = ROUGHNESS * ROUGHNESS * ROUGHNESS * ROUGHNESS;

inline Floats fresnel(float rise, Floats cosine) {
    const Floats x = 1.0f - at_most(at_least(cosine, 0.0f), 1.0f), square = x * x;
    return NORMAL_REFLECTANCE + rise * (square * (square * x));
}

inline Vector surface_normal(Vector n, Vector right, Vector up, Vector to_eye) {
    const Vector flat = cross(right, up);
    n = choose(dot(n, n) < 1e-12f, flat, n);
    n = choose(n.z * flat.z + n.y * flat.y < -(n.x * flat.x), Vector{-n.x, -n.y, -n.z}, n);
    n = unit(n);
    const Floats facing = dot(n, to_eye);
    return choose(facing < 0.0f, unit(n - to_eye * facing), n);
}

inline Floats coat(Vector n, Vector v, Vector l, Floats nl, Floats facing) {
    const Vector h = unit(l + v);
    const Floats nh = at_least(dot(n, h), 0.0f), nv = at_least(facing, 1e-4f);
    const Floats q = nh * nh * (A2 - 1.0f) + 1.0f;
    const Floats distribution = A2 / (PI * q * q);
    const Floats visibility =
        0.5f / (nl * root(nv * nv * (1.0f - A2) + A2) + nv * root(nl * nl * (1.0f - A2) + A2));
    return distribution * visibility * fresnel(1.0f - NORMAL_REFLECTANCE, dot(v, h));
}

// What reflects the base colour, and what the coat adds to it.
struct Shade {
    Floats body, gloss;
};

inline Shade radiance(const Light &light, Vector position, Vector v, Vector n, Floats facing) {
    Shade sum;
    sum.body = light.ambient * (1.0f + n.y / 3.0f);
    sum.gloss = light.ambient * fresnel(1.0f - ROUGHNESS - NORMAL_REFLECTANCE, facing);
    for (int64_t i = 0; i < light.lights; ++i) {
        const float *point = light.points + 4 * i;
        const Vector to_light = all(point + 1) - position;
        const Floats distance2 = at_least(dot(to_light, to_light), 1e-6f);
        const Vector l = to_light * (1.0f / root(distance2));
        const Floats nl = at_least(dot(n, l), 0.0f), irradiance = point[0] * nl / distance2;
        sum.body += irradiance / PI;
        sum.gloss += irradiance * coat(n, v, l, nl, facing);
    }
    return sum;
}

}  // namespace
