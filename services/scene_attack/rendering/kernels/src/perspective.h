// The shading sum over directions and lobes for a viewer at a finite distance, where each pixel has its own viewer
// direction (services/scene_attack/rendering/torch/shading.py).

// perspective.cpp has the sum without shadows and perspective_shadows.cpp that with them: apart, so that the compiler
// makes the same code, to the bit, of the one whether or not there is the other.

#pragma once

#include "lanes.h"
#include "seen.h"

namespace {

constexpr int TERMS = 6;  // number of Bernstein coefficients of a curve

template <class T> struct Scene {
    int64_t count, directions;
    int channels, lobes;        // channels: 1 where all three have the same lobes
    const T *normals, *viewers; // [count, 3], unit
    const T *towards;           // [3, directions]
    const T *light;             // [3, directions]
    const T *material;          // [channels, lobes, 2, TERMS]: log kappa and log gamma
    const uint8_t *visibility;  // [directions, count], in units of 1/255; null without shadows
    T cosine_floor, lowest, highest, max_log_kappa, max_log_gamma;  // bounds of n.h, of a lobe's log exponent, of curves
};

// The angle of the vector (x, y) from the x axis; x, y >= 0 and not both 0. It is halved twice, then atan's series runs.
template <class T> inline V<T> angle(V<T> x, V<T> y) {
    V<T> r = y / (x + root<T>(x * x + y * y));
    r = r / (T(1) + root<T>(T(1) + r * r));
    const int terms = sizeof(T) == 4 ? 5 : 12;
    V<T> z = r * r, p = all<T>((terms % 2 ? T(1) : T(-1)) / T(2 * terms - 1));
    for (int i = terms - 2; i >= 0; --i) p = p * z + (i % 2 ? T(-1) : T(1)) / T(2 * i + 1);
    return T(4) * r * p;
}

// Terms of the shading sum for one direction and a block of pixels.
template <class T> struct BrdfTerms {
    V<T> cosine, q, log_half, hx, hy, hz, basis[TERMS];

    BrdfTerms(const Scene<T> &s, const Block<T> &b, const Block<T> &v, T wx, T wy, T wz) {
        cosine = most<T>(b.x * wx + b.y * wy + b.z * wz, V<T>{});
        V<T> sx = v.x + wx, sy = v.y + wy, sz = v.z + wz, dx = v.x - wx, dy = v.y - wy, dz = v.z - wz;
        V<T> length = root<T>(sx * sx + sy * sy + sz * sz), across = root<T>(dx * dx + dy * dy + dz * dz);
        I<T> nowhere = length < T(1e-7);  // light from straight behind: no half vector
        V<T> inverse = choose<T>(nowhere, V<T>{}, T(1) / choose<T>(nowhere, all<T>(1), length));
        hx = sx * inverse, hy = sy * inverse, hz = sz * inverse;
        V<T> ex = b.x - hx, ey = b.y - hy, ez = b.z - hz;
        q = T(0.5) * (ex * ex + ey * ey + ez * ez) + choose<T>(nowhere, all<T>(0.5), V<T>{});
        q = least<T>(q, all<T>(1 - s.cosine_floor));
        log_half = log_1_minus<T>(q);
        V<T> t = least<T>(angle<T>(length, across) * T(0.63661977236758134308), all<T>(1)), u = T(1) - t;
        V<T> t2 = t * t, u2 = u * u;
        basis[0] = u2 * u2 * u, basis[1] = T(5) * t * u2 * u2, basis[2] = T(10) * t2 * u2 * u;
        basis[3] = T(10) * t2 * t * u2, basis[4] = T(5) * t2 * t2 * u, basis[5] = t2 * t2 * t;
    }

    V<T> curve(const T *coefficients) const {
        V<T> sum = basis[0] * coefficients[0];
        for (int i = 1; i < TERMS; ++i) sum += basis[i] * coefficients[i];
        return sum;
    }
};

template <class T, int C, bool SHADOWS> void forward(const Scene<T> &s, T *out, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, blocks = (s.count + n - 1) / n;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b) {
        Block<T> block(s.normals, s.count, b * n), viewer(s.viewers, s.count, b * n);
        V<T> result[3] = {};
        for (int64_t d = 0; d < D; ++d) {
            const T wx = s.towards[d], wy = s.towards[D + d], wz = s.towards[2 * D + d];
            if (block.closest(wx, wy, wz) <= 0) continue;
            BrdfTerms<T> m(s, block, viewer, wx, wy, wz);
            if (SHADOWS) m.cosine *= seen<T>(s.visibility, d, s.count, b * n);
            for (int c = 0; c < C; ++c) {
                V<T> rho{};
                for (int l = 0; l < s.lobes; ++l) {
                    const T *curves = s.material + (c * s.lobes + l) * 2 * TERMS;
                    V<T> kappa = least<T>(m.curve(curves), all<T>(s.max_log_kappa));
                    V<T> log_gamma = least<T>(m.curve(curves + TERMS), all<T>(s.max_log_gamma));
                    V<T> gamma = exponential<T>(most<T>(log_gamma, all<T>(-40)));
                    V<T> x = most<T>(least<T>(kappa + gamma * m.log_half, all<T>(s.highest)), all<T>(s.lowest));
                    rho += exponential_minus_1<T>(exponential<T>(x));
                }
                rho *= m.cosine;
                if (C == 3) result[c] += rho * s.light[c * D + d];
                else for (int k = 0; k < 3; ++k) result[k] += rho * s.light[k * D + d];
            }
        }
        for (int i = 0; i < n && b * n + i < s.count; ++i)
            for (int k = 0; k < 3; ++k) out[3 * (b * n + i) + k] = result[k][i];
    }
}

// d_out, d_normals [count, 3]; d_light [3, D]; d_material has the shape of the material.
template <class T, int C, bool SHADOWS>
void backward(const Scene<T> &s, const T *d_out, T *d_light, T *d_material, T *d_normals, int threads) {
    const int n = Lanes<T>::count, curves = C * s.lobes * 2 * TERMS;
    const int64_t D = s.directions, parts = (s.count + PART - 1) / PART, width = 3 * D + curves;
    std::vector<T> partial(parts * width, T(0));
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int64_t part = 0; part < parts; ++part) {
        const int64_t end = std::min(s.count, (part + 1) * PART);
        std::vector<V<T>> sum_light(3 * D, V<T>{}), sum_material(curves, V<T>{});
        for (int64_t first = part * PART; first < end; first += n) {
            Block<T> block(s.normals, s.count, first), viewer(s.viewers, s.count, first);
            V<T> d_pixel[3] = {}, nx{}, ny{}, nz{};
            for (int i = 0; i < n && first + i < end; ++i)
                for (int k = 0; k < 3; ++k) d_pixel[k][i] = d_out[3 * (first + i) + k];
            for (int64_t d = 0; d < D; ++d) {
                const T wx = s.towards[d], wy = s.towards[D + d], wz = s.towards[2 * D + d];
                if (block.closest(wx, wy, wz) <= 0) continue;
                BrdfTerms<T> m(s, block, viewer, wx, wy, wz);
                V<T> lit[3], d_cosine{}, d_log{};
                V<T> g[3] = {d_pixel[0], d_pixel[1], d_pixel[2]};
                if (SHADOWS)
                    for (int k = 0; k < 3; ++k) g[k] *= seen<T>(s.visibility, d, s.count, first);
                for (int k = 0; k < 3; ++k) lit[k] = g[k] * s.light[k * D + d];
                if (C == 1) lit[0] += lit[1] + lit[2];
                for (int c = 0; c < C; ++c) {
                    V<T> rho{}, weight = lit[c] * m.cosine;
                    for (int l = 0; l < s.lobes; ++l) {
                        const int place = (c * s.lobes + l) * 2 * TERMS;
                        V<T> log_kappa = m.curve(s.material + place), log_gamma = m.curve(s.material + place + TERMS);
                        V<T> gamma = exponential<T>(most<T>(least<T>(log_gamma, all<T>(s.max_log_gamma)), all<T>(-40)));
                        V<T> x = least<T>(log_kappa, all<T>(s.max_log_kappa)) + gamma * m.log_half;
                        V<T> exponent = exponential<T>(most<T>(least<T>(x, all<T>(s.highest)), all<T>(s.lowest)));
                        V<T> lobe = exponential_minus_1<T>(exponent);
                        rho += lobe;
                        V<T> y = (V<T>)((I<T>)(exponent * (lobe + T(1)) * weight) & (x < s.highest));
                        d_log += y * gamma;
                        V<T> d_kappa = (V<T>)((I<T>)y & (log_kappa < s.max_log_kappa));
                        V<T> d_gamma = (V<T>)((I<T>)(y * m.log_half * gamma) & (log_gamma < s.max_log_gamma));
                        for (int i = 0; i < TERMS; ++i) {
                            sum_material[place + i] += d_kappa * m.basis[i];
                            sum_material[place + TERMS + i] += d_gamma * m.basis[i];
                        }
                    }
                    d_cosine += rho * lit[c];
                    if (C == 3) sum_light[c * D + d] += rho * m.cosine * g[c];
                    else for (int k = 0; k < 3; ++k) sum_light[k * D + d] += rho * m.cosine * g[k];
                }
                d_cosine = (V<T>)((I<T>)d_cosine & (m.cosine > T(0)));
                d_log = (V<T>)((I<T>)(d_log / (T(1) - m.q)) & (m.q < 1 - s.cosine_floor));
                nx += d_cosine * wx + d_log * m.hx;
                ny += d_cosine * wy + d_log * m.hy;
                nz += d_cosine * wz + d_log * m.hz;
            }
            for (int i = 0; i < n && first + i < end; ++i) {
                T *to = d_normals + 3 * (first + i);
                to[0] = nx[i], to[1] = ny[i], to[2] = nz[i];
            }
        }
        for (int64_t i = 0; i < 3 * D; ++i) partial[part * width + i] = sum<T>(sum_light[i]);
        for (int i = 0; i < curves; ++i) partial[part * width + 3 * D + i] = sum<T>(sum_material[i]);
    }
    for (int64_t i = 0; i < width; ++i) {
        T total = 0;
        for (int64_t part = 0; part < parts; ++part) total += partial[part * width + i];
        (i < 3 * D ? d_light[i] : d_material[i - 3 * D]) = total;
    }
}

}  // namespace

// The sums of a scene with shadows; `scene` is a Scene<T>.
#define SHADOWED(T, NAME)                                                                                              \
    void shade_perspective_shadows(const void *scene, T *out, int threads);                                            \
    void shade_perspective_shadows_backward(const void *scene, const T *d_out, T *d_light, T *d_material,              \
                                            T *d_normals, int threads);
SHADOWED(float, float)
SHADOWED(double, double)
#undef SHADOWED
