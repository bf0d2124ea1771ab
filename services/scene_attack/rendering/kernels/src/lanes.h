// SIMD vectors with one normal per lane, and the elementary functions that shading needs.
//
// Every loop over blocks of normals is split into parts whose number does not depend on the number of threads, and the
// parts' sums are added in order, so the bits are the same for any number of threads.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace {

constexpr int BYTES = 64;

template <class T> struct Lanes;
template <> struct Lanes<float> {
    typedef float V __attribute__((vector_size(BYTES)));
    typedef int32_t I __attribute__((vector_size(BYTES)));
    static constexpr int count = 16, mantissa = 23, exp_terms = 8, log_terms = 5;
    static constexpr int32_t bias = 127, root_half = 0x3f3504f3;
    static constexpr float round_magic = 12582912.0f, ln2_high = 0.693359375f, ln2_low = -2.12194440e-4f;
    // exp(-23) = 1e-10, a ten-thousandth of the reflectance of the darkest lobe that a material may have.
    static constexpr float negligible = -23.0f;
};
template <> struct Lanes<double> {
    typedef double V __attribute__((vector_size(BYTES)));
    typedef int64_t I __attribute__((vector_size(BYTES)));
    static constexpr int count = 8, mantissa = 52, exp_terms = 14, log_terms = 11;
    static constexpr int64_t bias = 1023, root_half = 0x3fe6a09e667f3bcd;
    static constexpr double round_magic = 6755399441055744.0, ln2_high = 6.93147180369123816490e-01,
                            ln2_low = 1.90821492927058770002e-10;
    static constexpr double negligible = -1e300;  // no lobe is negligible: double is the exact path
};

template <class T> using V = typename Lanes<T>::V;
template <class T> using I = typename Lanes<T>::I;

template <class T> inline V<T> all(T value) { return V<T>{} + value; }
template <class T> inline V<T> choose(I<T> mask, V<T> yes, V<T> no) {
    return (V<T>)((mask & (I<T>)yes) | (~mask & (I<T>)no));
}
template <class T> inline V<T> least(V<T> a, V<T> b) { return choose<T>(a < b, a, b); }
template <class T> inline V<T> most(V<T> a, V<T> b) { return choose<T>(a > b, a, b); }
template <class T> inline V<T> root(V<T> x) {
    V<T> r;
    for (int i = 0; i < Lanes<T>::count; ++i) r[i] = std::sqrt(x[i]);
    return r;
}
template <class T> inline T sum(V<T> v) {
    T total = 0;
    for (int i = 0; i < Lanes<T>::count; ++i) total += v[i];
    return total;
}

template <class T, int n> inline V<T> taylor(V<T> r) {  // exp(r) for |r| <= ln(2)/2
    V<T> p = all<T>(1);
    for (int k = n; k > 0; --k) p = p * r * (T(1) / T(k)) + T(1);
    return p;
}

// exp for arguments whose result is a normal number.
template <class T> inline V<T> exponential(V<T> x) {
    using L = Lanes<T>;
    V<T> shifted = x * T(1.4426950408889634074) + L::round_magic;
    V<T> n = shifted - L::round_magic;
    V<T> r = x - n * L::ln2_high - n * L::ln2_low;
    I<T> power = (I<T>)shifted - (I<T>)all<T>(L::round_magic);
    return taylor<T, L::exp_terms - 1>(r) * (V<T>)((power + L::bias) << L::mantissa);
}

template <class T> inline V<T> exponential_minus_1(V<T> x) {  // x >= 0
    V<T> small = x * (T(1) + x * (T(0.5) + x * (T(1.0 / 6) + x * (T(1.0 / 24) + x * T(1.0 / 120)))));
    T limit = sizeof(T) == 4 ? T(0.03) : T(1e-3);  // relative errors of the series: 1e-12 and 1e-18
    return choose<T>(x < limit, small, exponential<T>(x) - T(1));
}

// log c for c > 0, given c - 1: with s = (m - 1) / (m + 1), log m = 2 atanh s. Near c = 1 nothing cancels.
template <class T> inline V<T> log_of(V<T> c, V<T> less_1) {
    using L = Lanes<T>;
    I<T> bits = (I<T>)c;
    I<T> k = (bits - L::root_half) >> L::mantissa;
    V<T> m = (V<T>)(bits - (k << L::mantissa));
    V<T> s = choose<T>(k == 0, less_1, m - T(1)) / (m + T(1));
    V<T> z = s * s, p = all<T>(T(1) / T(2 * L::log_terms - 1));
    for (int i = L::log_terms - 2; i >= 0; --i) p = p * z + T(1) / T(2 * i + 1);
    return T(2) * s * p + __builtin_convertvector(k, V<T>) * T(0.69314718055994530942);
}

template <class T> inline V<T> log_of(V<T> c) { return log_of<T>(c, c - T(1)); }
template <class T> inline V<T> log_1_minus(V<T> q) { return log_of<T>(T(1) - q, -q); }  // q in [0, 1)

// A block of unit normals, one per lane, and their bounding cone, which finds directions below every normal's horizon.
template <class T> struct Block {
    V<T> x, y, z;
    T cx, cy, cz, cos_radius, sin_radius;

    Block(const T *normals, int64_t total, int64_t first) {
        const int n = Lanes<T>::count;
        T sx = 0, sy = 0, sz = 0;
        for (int i = 0; i < n; ++i) {
            const T *v = normals + 3 * std::min(first + i, total - 1);
            x[i] = v[0], y[i] = v[1], z[i] = v[2];
            sx += v[0], sy += v[1], sz += v[2];
        }
        T length = std::sqrt(sx * sx + sy * sy + sz * sz);
        cos_radius = -1;
        cx = cy = cz = 0;
        if (length > 0) {
            cx = sx / length, cy = sy / length, cz = sz / length;
            cos_radius = 1;
            for (int i = 0; i < n; ++i) cos_radius = std::min(cos_radius, x[i] * cx + y[i] * cy + z[i] * cz);
            cos_radius -= T(1e-6);
        }
        sin_radius = std::sqrt(std::max(T(0), 1 - cos_radius * cos_radius));
    }

    // An upper bound of the cosine between a unit vector and any normal of the block.
    T closest(T vx, T vy, T vz) const {
        T c = cx * vx + cy * vy + cz * vz;
        if (cos_radius <= 0 || c >= cos_radius) return 1;
        return c * cos_radius + std::sqrt(std::max(T(0), 1 - c * c)) * sin_radius + T(1e-6);
    }
};

constexpr int64_t PART = 1024;  // normals per part: a part's gradients are summed first

}  // namespace

#define EXPORT extern "C" __attribute__((visibility("default")))
