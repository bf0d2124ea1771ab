// The shading sum over directions and lobes for a distant viewer (services/scene_attack/rendering/torch/shading.py).

#include "lanes.h"
#include "layout.h"
#include "seen.h"

namespace {

template <class T> struct Scene {
    int64_t count, directions;
    int channels, lobes;         // channels: 1 where all three have the same lobes
    const T *normals;            // [count, 3]
    const T *towards;            // [3, directions], unit vectors to the light
    const T *half;               // [4, directions]: half vector; fourth row 1/2 where it is zero, else 0
    const T *light;              // [3, directions]
    const T *base, *tilt;        // [channels, directions]: sum of linearised lobes, base + tilt * log n.h
    const T *log_kappa, *gamma;  // [channels, lobes, directions]
    const uint8_t *visibility;   // [directions, count], in units of 1/255; null without shadows
    T cosine_floor, lowest, highest;  // bounds of n.h, and of the logarithm of a lobe's exponent

    const T *lobe(const T *of, int c, int l) const { return of + (c * lobes + l) * directions; }
};

// Terms of the shading sum for one direction and a block of normals.
template <class T> struct BrdfTerms {
    bool dark;
    V<T> cosine, q, log_half;
    T log_closest;

    BrdfTerms(const Scene<T> &s, const Block<T> &b, int64_t d) {
        const int64_t D = s.directions;
        T wx = s.towards[d], wy = s.towards[D + d], wz = s.towards[2 * D + d];
        dark = b.closest(wx, wy, wz) <= 0;
        if (dark) return;
        T hx = s.half[d], hy = s.half[D + d], hz = s.half[2 * D + d], pad = s.half[3 * D + d];
        cosine = most<T>(b.x * wx + b.y * wy + b.z * wz, V<T>{});
        // 1 - n.h is half the squared distance of n and h, without cancellation where sharp lobes have their peak.
        V<T> dx = b.x - hx, dy = b.y - hy, dz = b.z - hz;
        q = least<T>(T(0.5) * (dx * dx + dy * dy + dz * dz) + pad, all<T>(1 - s.cosine_floor));
        log_half = log_1_minus<T>(q);
        T c = pad > 0 ? s.cosine_floor : std::max(s.cosine_floor, b.closest(hx, hy, hz));
        log_closest = c >= 1 ? T(0) : std::log(c);
    }

    bool negligible(T log_kappa, T gamma) const { return log_kappa + gamma * log_closest < Lanes<T>::negligible; }

    // Reflectance times cosine in channel c.
    V<T> reflected(const Scene<T> &s, int c, int64_t d) const {
        V<T> rho = s.base[c * s.directions + d] + s.tilt[c * s.directions + d] * log_half;
        for (int l = 0; l < s.lobes; ++l) {
            T kappa = s.lobe(s.log_kappa, c, l)[d], gamma = s.lobe(s.gamma, c, l)[d];
            if (negligible(kappa, gamma)) continue;
            V<T> x = most<T>(least<T>(kappa + gamma * log_half, all<T>(s.highest)), all<T>(s.lowest));
            rho += exponential_minus_1<T>(exponential<T>(x));
        }
        return rho * cosine;
    }
};

template <class T, int C, bool SHADOWS> void forward(const Scene<T> &s, T *out, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, blocks = (s.count + n - 1) / n;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b) {
        Block<T> block(s.normals, s.count, b * n);
        V<T> result[3] = {};
        for (int64_t d = 0; d < D; ++d) {
            BrdfTerms<T> m(s, block, d);
            if (m.dark) continue;
            if (SHADOWS) m.cosine *= seen<T>(s.visibility, d, s.count, b * n);
            for (int c = 0; c < C; ++c) {
                V<T> rho = m.reflected(s, c, d);
                if (C == 3) {
                    result[c] += rho * s.light[c * D + d];
                } else {
                    for (int k = 0; k < 3; ++k) result[k] += rho * s.light[k * D + d];
                }
            }
        }
        for (int i = 0; i < n && b * n + i < s.count; ++i)
            for (int k = 0; k < 3; ++k) out[3 * (b * n + i) + k] = result[k][i];
    }
}

constexpr int64_t TILE = 64;    // directions per tile: their sums fit in the second-level cache

// d_light [3, D], d_kappa and d_gamma [C, lobes, D], d_normals [count, 3]; any of the three may be null.
template <class T, int C, bool SHADOWS>
void backward(const Scene<T> &s, const T *d_out, T *d_light, T *d_kappa, T *d_gamma, T *d_normals, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, parts = (s.count + PART - 1) / PART;
    const int lobes = C * s.lobes, width = 3 + 2 * lobes;
    std::vector<T> partial(parts * width * D, T(0));
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int64_t part = 0; part < parts; ++part) {
        const int64_t end = std::min(s.count, (part + 1) * PART);
        std::vector<V<T>> sums(TILE * width);
        for (int64_t tile = 0; tile < D; tile += TILE) {
            const int64_t last = std::min(D, tile + TILE);
            std::fill(sums.begin(), sums.end(), V<T>{});
            for (int64_t first = part * PART; first < end; first += n) {
                Block<T> block(s.normals, s.count, first);
                V<T> d_pixel[3] = {}, nx{}, ny{}, nz{};
                for (int i = 0; i < n && first + i < end; ++i)
                    for (int k = 0; k < 3; ++k) d_pixel[k][i] = d_out[3 * (first + i) + k];
                for (int64_t d = tile; d < last; ++d) {
                    BrdfTerms<T> m(s, block, d);
                    if (m.dark) continue;
                    V<T> *to = sums.data() + (d - tile) * width;
                    V<T> lit[3], d_cosine{}, d_log{};
                    V<T> g[3] = {d_pixel[0], d_pixel[1], d_pixel[2]};
                    if (SHADOWS)
                        for (int k = 0; k < 3; ++k) g[k] *= seen<T>(s.visibility, d, s.count, first);
                    for (int k = 0; k < 3; ++k) lit[k] = g[k] * s.light[k * D + d];
                    if (C == 1) lit[0] += lit[1] + lit[2];
                    for (int c = 0; c < C; ++c) {
                        V<T> rho = s.base[c * D + d] + s.tilt[c * D + d] * m.log_half, weight = lit[c] * m.cosine;
                        d_log += s.tilt[c * D + d] * weight;
                        for (int l = 0; l < s.lobes; ++l) {
                            T kappa = s.lobe(s.log_kappa, c, l)[d], gamma = s.lobe(s.gamma, c, l)[d];
                            if (m.negligible(kappa, gamma)) continue;
                            V<T> x = kappa + gamma * m.log_half;
                            V<T> held = most<T>(least<T>(x, all<T>(s.highest)), all<T>(s.lowest));
                            V<T> exponent = exponential<T>(held), lobe = exponential_minus_1<T>(exponent);
                            rho += lobe;
                            V<T> y = exponent * (lobe + T(1)) * weight;
                            y = (V<T>)((I<T>)y & (x < s.highest));
                            to[3 + c * s.lobes + l] += y;
                            to[3 + lobes + c * s.lobes + l] += y * m.log_half;
                            d_log += y * gamma;
                        }
                        d_cosine += rho * lit[c];
                        if (C == 3) to[c] += rho * m.cosine * g[c];
                        else for (int k = 0; k < 3; ++k) to[k] += rho * m.cosine * g[k];
                    }
                    if (d_normals) {
                        d_cosine = (V<T>)((I<T>)d_cosine & (m.cosine > T(0)));
                        d_log = (V<T>)((I<T>)(d_log / (T(1) - m.q)) & (m.q < 1 - s.cosine_floor));
                        nx += d_cosine * s.towards[d] + d_log * s.half[d];
                        ny += d_cosine * s.towards[D + d] + d_log * s.half[D + d];
                        nz += d_cosine * s.towards[2 * D + d] + d_log * s.half[2 * D + d];
                    }
                }
                if (d_normals)
                    for (int i = 0; i < n && first + i < end; ++i) {
                        T *to = d_normals + 3 * (first + i);
                        to[0] += nx[i], to[1] += ny[i], to[2] += nz[i];
                    }
            }
            for (int64_t d = tile; d < last; ++d)
                for (int w = 0; w < width; ++w)
                    partial[(part * width + w) * D + d] = sum<T>(sums[(d - tile) * width + w]);
        }
    }
    T *rows[3] = {d_light, d_kappa, d_gamma};
    const int64_t sizes[3] = {3, lobes, lobes}, starts[3] = {0, 3, 3 + lobes};
    for (int r = 0; r < 3; ++r)
        if (rows[r])
            for (int64_t i = 0; i < sizes[r] * D; ++i) {
                T total = 0;
                for (int64_t part = 0; part < parts; ++part) total += partial[(part * width + starts[r]) * D + i];
                rows[r][i] = total;
            }
}

// Writes reflectance times cosine and visibility to out [C, D, count].
template <class T, int C, bool SHADOWS> void transport(const Scene<T> &s, T *out, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, blocks = (s.count + n - 1) / n;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b) {
        Block<T> block(s.normals, s.count, b * n);
        const int lanes = (int)std::min<int64_t>(n, s.count - b * n);
        for (int64_t d = 0; d < D; ++d) {
            BrdfTerms<T> m(s, block, d);
            for (int c = 0; c < C; ++c) {
                V<T> rho = m.dark ? V<T>{} : m.reflected(s, c, d);
                if (SHADOWS) rho *= seen<T>(s.visibility, d, s.count, b * n);
                std::memcpy(out + (c * D + d) * s.count + b * n, &rho, lanes * sizeof(T));
            }
        }
    }
}

}  // namespace

#define BOTH(T, NAME)                                                                                                  \
    EXPORT void shade_##NAME(const Scene<T> *s, T *out, int threads) {                                                 \
        CHOOSE(forward, T, *s, out, threads);                                                                          \
    }                                                                                                                  \
    EXPORT void shade_backward_##NAME(const Scene<T> *s, const T *d_out, T *d_light, T *d_kappa, T *d_gamma,           \
                                      T *d_normals, int threads) {                                                     \
        CHOOSE(backward, T, *s, d_out, d_light, d_kappa, d_gamma, d_normals, threads);                                 \
    }                                                                                                                  \
    EXPORT void transport_##NAME(const Scene<T> *s, T *out, int threads) {                                             \
        CHOOSE(transport, T, *s, out, threads);                                                                        \
    }

#define DESCRIBE(T)                                                                                                    \
    STRUCTURE(Scene<T>, T, "shading.Scene." #T,                                                                        \
              FIELD(Scene<T>, count) FIELD(Scene<T>, directions) FIELD(Scene<T>, channels) FIELD(Scene<T>, lobes)      \
              FIELD(Scene<T>, normals) FIELD(Scene<T>, towards) FIELD(Scene<T>, half) FIELD(Scene<T>, light)           \
              FIELD(Scene<T>, base) FIELD(Scene<T>, tilt) FIELD(Scene<T>, log_kappa) FIELD(Scene<T>, gamma)            \
              FIELD(Scene<T>, visibility)                                                                              \
              FIELD(Scene<T>, cosine_floor) FIELD(Scene<T>, lowest) FIELD(Scene<T>, highest))                          \
    FUNCTION(shade_##T) FUNCTION(shade_backward_##T) FUNCTION(transport_##T)

BOTH(float, float)
BOTH(double, double)
DESCRIBE(float)
DESCRIBE(double)
