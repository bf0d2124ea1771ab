// The shading sum of surfaces that reflect the same share of the light in every direction
// (services/scene_attack/rendering/torch/shading.py): no half vectors, so that it costs a cosine for each direction.

#include "layout.h"
#include "seen.h"

namespace {

template <class T> struct Irradiance {
    int64_t count, directions;
    const T *normals;           // [count, 3], unit
    const T *towards;           // [3, directions], unit vectors to the light
    const T *light;             // [3, directions]
    const uint8_t *visibility;  // [directions, count], in units of 1/255; null without shadows
};

// n.w where it is positive, times the visibility; `reaches` is that factor of the light alone, 0 below the horizon.
template <class T> struct Term {
    bool dark;
    V<T> cosine, reaches;

    Term(const Irradiance<T> &s, const Block<T> &b, int64_t d, int64_t first) {
        const int64_t D = s.directions;
        const T wx = s.towards[d], wy = s.towards[D + d], wz = s.towards[2 * D + d];
        dark = b.closest(wx, wy, wz) <= 0;
        if (dark) return;
        cosine = b.x * wx + b.y * wy + b.z * wz;
        reaches = choose<T>(cosine > T(0), s.visibility ? seen<T>(s.visibility, d, s.count, first) : all<T>(1), V<T>{});
        cosine *= reaches;
    }
};

// out [count, 3]
template <class T> void forward(const Irradiance<T> &s, T *out, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, blocks = (s.count + n - 1) / n;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b) {
        const Block<T> block(s.normals, s.count, b * n);
        V<T> result[3] = {};
        for (int64_t d = 0; d < D; ++d) {
            const Term<T> term(s, block, d, b * n);
            if (term.dark) continue;
            for (int k = 0; k < 3; ++k) result[k] += term.cosine * s.light[k * D + d];
        }
        for (int i = 0; i < n && b * n + i < s.count; ++i)
            for (int k = 0; k < 3; ++k) out[3 * (b * n + i) + k] = result[k][i];
    }
}

// d_out, d_normals [count, 3]; d_light [3, D].
template <class T> void backward(const Irradiance<T> &s, const T *d_out, T *d_light, T *d_normals, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, parts = (s.count + PART - 1) / PART;
    std::vector<T> partial(parts * 3 * D, T(0));
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int64_t part = 0; part < parts; ++part) {
        const int64_t end = std::min(s.count, (part + 1) * PART);
        std::vector<V<T>> sums(3 * D, V<T>{});
        for (int64_t first = part * PART; first < end; first += n) {
            const Block<T> block(s.normals, s.count, first);
            V<T> g[3] = {}, d_normal[3] = {};
            for (int i = 0; i < n && first + i < end; ++i)
                for (int k = 0; k < 3; ++k) g[k][i] = d_out[3 * (first + i) + k];
            for (int64_t d = 0; d < D; ++d) {
                const Term<T> term(s, block, d, first);
                if (term.dark) continue;
                V<T> weight{};
                for (int k = 0; k < 3; ++k) {
                    sums[3 * d + k] += g[k] * term.cosine;
                    weight += g[k] * s.light[k * D + d];
                }
                weight *= term.reaches;
                for (int k = 0; k < 3; ++k) d_normal[k] += weight * s.towards[k * D + d];
            }
            for (int i = 0; i < n && first + i < end; ++i)
                for (int k = 0; k < 3; ++k) d_normals[3 * (first + i) + k] = d_normal[k][i];
        }
        for (int64_t d = 0; d < D; ++d)
            for (int k = 0; k < 3; ++k) partial[(part * 3 + k) * D + d] = sum<T>(sums[3 * d + k]);
    }
    for (int64_t i = 0; i < 3 * D; ++i) {
        T total = 0;
        for (int64_t part = 0; part < parts; ++part) total += partial[part * 3 * D + i];
        d_light[i] = total;
    }
}

}  // namespace

#define DEFINE(T)                                                                                                      \
    EXPORT void lambert_##T(const Irradiance<T> *s, T *out, int threads) { forward<T>(*s, out, threads); }             \
    EXPORT void lambert_backward_##T(const Irradiance<T> *s, const T *d_out, T *d_light, T *d_normals, int threads) {  \
        backward<T>(*s, d_out, d_light, d_normals, threads);                                                           \
    }                                                                                                                  \
    STRUCTURE(Irradiance<T>, T, "lambert.Irradiance." #T,                                                              \
              FIELD(Irradiance<T>, count) FIELD(Irradiance<T>, directions) FIELD(Irradiance<T>, normals)               \
              FIELD(Irradiance<T>, towards) FIELD(Irradiance<T>, light) FIELD(Irradiance<T>, visibility))              \
    FUNCTION(lambert_##T) FUNCTION(lambert_backward_##T)

DEFINE(float)
DEFINE(double)
