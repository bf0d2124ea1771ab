// The inner loops of shading and of the table lookup. services/rendering/native.py compiles this file and binds it;
// shading.py and table.py hold the same sums in torch, which say what is computed here and test it.
//
// Normals are taken in blocks of one vector register, one normal a lane. Every loop over blocks is cut into parts whose
// number does not depend on the number of threads, and parts are added up in order: the same bits on any number of cores.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace {

constexpr int BYTES = 64;
constexpr int MOST_LOBES = 8;

template <class T> struct Lanes;
template <> struct Lanes<float> {
    typedef float V __attribute__((vector_size(BYTES)));
    typedef int32_t I __attribute__((vector_size(BYTES)));
    static constexpr int count = 16, mantissa = 23, exp_terms = 8, log_terms = 5;
    static constexpr int32_t bias = 127, root_half = 0x3f3504f3;
    static constexpr float round_magic = 12582912.0f, ln2_high = 0.693359375f, ln2_low = -2.12194440e-4f;
    // exp(-23) = 1e-10, a ten-thousandth of what the darkest lobe that a material may have reflects.
    static constexpr float negligible = -23.0f;
};
template <> struct Lanes<double> {
    typedef double V __attribute__((vector_size(BYTES)));
    typedef int64_t I __attribute__((vector_size(BYTES)));
    static constexpr int count = 8, mantissa = 52, exp_terms = 14, log_terms = 11;
    static constexpr int64_t bias = 1023, root_half = 0x3fe6a09e667f3bcd;
    static constexpr double round_magic = 6755399441055744.0, ln2_high = 6.93147180369123816490e-01,
                            ln2_low = 1.90821492927058770002e-10;
    static constexpr double negligible = -1e300;  // nothing is: double is the exact path
};

template <class T> using V = typename Lanes<T>::V;
template <class T> using I = typename Lanes<T>::I;

template <class T> inline V<T> all(T value) { return V<T>{} + value; }
template <class T> inline V<T> choose(I<T> mask, V<T> yes, V<T> no) {
    return (V<T>)((mask & (I<T>)yes) | (~mask & (I<T>)no));
}
template <class T> inline V<T> least(V<T> a, V<T> b) { return choose<T>(a < b, a, b); }
template <class T> inline V<T> most(V<T> a, V<T> b) { return choose<T>(a > b, a, b); }
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

// log(1 - q) for q in [0, 1): with s = (m - 1) / (m + 1), log m = 2 atanh s. Near q = 0 nothing cancels.
template <class T> inline V<T> log_1_minus(V<T> q) {
    using L = Lanes<T>;
    V<T> c = T(1) - q;
    I<T> bits = (I<T>)c;
    I<T> k = (bits - L::root_half) >> L::mantissa;
    V<T> m = (V<T>)(bits - (k << L::mantissa));
    V<T> s = choose<T>(k == 0, -q, m - T(1)) / (m + T(1));
    V<T> z = s * s, p = all<T>(T(1) / T(2 * L::log_terms - 1));
    for (int i = L::log_terms - 2; i >= 0; --i) p = p * z + T(1) / T(2 * i + 1);
    return T(2) * s * p + __builtin_convertvector(k, V<T>) * T(0.69314718055994530942);
}

template <class T> struct Scene {
    int64_t count, directions;
    int channels, lobes;         // channels: 1 where all three have the same lobes
    const T *normals;            // [count, 3]
    const T *towards;            // [3, directions]
    const T *half;               // [4, directions]: half vector, and 1/2 where it has no direction (and is zero)
    const T *light;              // [3, directions]
    const T *base, *tilt;        // [channels, directions]: reflectance of all other lobes, base + tilt * log n.h
    const T *log_kappa, *gamma;  // [channels, lobes, directions]
    T cosine_floor, lowest, highest;

    const T *lobe(const T *of, int c, int l) const { return of + (c * lobes + l) * directions; }
};

template <class T> struct Block {
    V<T> x, y, z;
    T cx, cy, cz, cos_radius, sin_radius;

    Block(const Scene<T> &s, int64_t first) {
        const int n = Lanes<T>::count;
        T sx = 0, sy = 0, sz = 0;
        for (int i = 0; i < n; ++i) {
            const T *v = s.normals + 3 * std::min(first + i, s.count - 1);
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

    // At least the largest cosine between a normal of the block and a unit vector.
    T closest(T vx, T vy, T vz) const {
        T c = cx * vx + cy * vy + cz * vz;
        if (cos_radius <= 0 || c >= cos_radius) return 1;
        return c * cos_radius + std::sqrt(std::max(T(0), 1 - c * c)) * sin_radius + T(1e-6);
    }
};

// What one direction does to one block of normals.
template <class T> struct Meeting {
    bool dark;
    V<T> cosine, q, log_half;
    T log_closest;

    Meeting(const Scene<T> &s, const Block<T> &b, int64_t d) {
        const int64_t D = s.directions;
        T wx = s.towards[d], wy = s.towards[D + d], wz = s.towards[2 * D + d];
        dark = b.closest(wx, wy, wz) <= 0;
        if (dark) return;
        T hx = s.half[d], hy = s.half[D + d], hz = s.half[2 * D + d], pad = s.half[3 * D + d];
        cosine = most<T>(b.x * wx + b.y * wy + b.z * wz, V<T>{});
        // 1 - n.h as half the square of their distance: exact where they nearly meet and a sharp lobe looks
        V<T> dx = b.x - hx, dy = b.y - hy, dz = b.z - hz;
        q = least<T>(T(0.5) * (dx * dx + dy * dy + dz * dz) + pad, all<T>(1 - s.cosine_floor));
        log_half = log_1_minus<T>(q);
        T c = pad > 0 ? s.cosine_floor : std::max(s.cosine_floor, b.closest(hx, hy, hz));
        log_closest = c >= 1 ? T(0) : std::log(c);
    }

    bool negligible(T log_kappa, T gamma) const { return log_kappa + gamma * log_closest < Lanes<T>::negligible; }
};

template <class T, int C> void forward(const Scene<T> &s, T *out, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, blocks = (s.count + n - 1) / n;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b) {
        Block<T> block(s, b * n);
        V<T> result[3] = {};
        for (int64_t d = 0; d < D; ++d) {
            Meeting<T> m(s, block, d);
            if (m.dark) continue;
            for (int c = 0; c < C; ++c) {
                V<T> rho = s.base[c * D + d] + s.tilt[c * D + d] * m.log_half;
                for (int l = 0; l < s.lobes; ++l) {
                    T kappa = s.lobe(s.log_kappa, c, l)[d], gamma = s.lobe(s.gamma, c, l)[d];
                    if (m.negligible(kappa, gamma)) continue;
                    V<T> x = most<T>(least<T>(kappa + gamma * m.log_half, all<T>(s.highest)), all<T>(s.lowest));
                    rho += exponential_minus_1<T>(exponential<T>(x));
                }
                rho *= m.cosine;
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

constexpr int64_t PART = 1024;  // normals whose slopes are added up before those of others
constexpr int64_t TILE = 64;    // directions at once: their sums stay in the second-level cache

// d_light [3, D], d_kappa and d_gamma [C, lobes, D], d_normals [count, 3]; any of the three may be null.
template <class T, int C>
void backward(const Scene<T> &s, const T *slope, T *d_light, T *d_kappa, T *d_gamma, T *d_normals, int threads) {
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
                Block<T> block(s, first);
                V<T> g[3] = {}, nx{}, ny{}, nz{};
                for (int i = 0; i < n && first + i < end; ++i)
                    for (int k = 0; k < 3; ++k) g[k][i] = slope[3 * (first + i) + k];
                for (int64_t d = tile; d < last; ++d) {
                    Meeting<T> m(s, block, d);
                    if (m.dark) continue;
                    V<T> *to = sums.data() + (d - tile) * width;
                    V<T> lit[3], d_cosine{}, d_log{};
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

// out [C, D, count]: reflectance times cosine.
template <class T, int C> void transport(const Scene<T> &s, T *out, int threads) {
    const int n = Lanes<T>::count;
    const int64_t D = s.directions, blocks = (s.count + n - 1) / n;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b) {
        Block<T> block(s, b * n);
        const int lanes = (int)std::min<int64_t>(n, s.count - b * n);
        for (int64_t d = 0; d < D; ++d) {
            Meeting<T> m(s, block, d);
            for (int c = 0; c < C; ++c) {
                V<T> rho{};
                if (!m.dark) {
                    rho = s.base[c * D + d] + s.tilt[c * D + d] * m.log_half;
                    for (int l = 0; l < s.lobes; ++l) {
                        T kappa = s.lobe(s.log_kappa, c, l)[d], gamma = s.lobe(s.gamma, c, l)[d];
                        if (m.negligible(kappa, gamma)) continue;
                        V<T> x = most<T>(least<T>(kappa + gamma * m.log_half, all<T>(s.highest)), all<T>(s.lowest));
                        rho += exponential_minus_1<T>(exponential<T>(x));
                    }
                    rho *= m.cosine;
                }
                std::memcpy(out + (c * D + d) * s.count + b * n, &rho, lanes * sizeof(T));
            }
        }
    }
}

// A table over the sphere in the two angles of a normal: row i at polar angle (i + 1/2) h, column j at azimuth
// -pi + (j + 1/2) h, h = pi / rows, 2 rows columns. Past a pole the rows come back half a turn further round.
template <class T> struct Spot {
    int64_t nodes[4][4];
    T row[4], column[4], d_row[4], d_column[4];

    static int64_t wrapped(int64_t k, int64_t turn) { return k >= 0 && k < turn ? k : (k % turn + turn) % turn; }

    static void weights(T f, T *w, T *d) {  // Catmull-Rom and its derivative
        w[0] = T(0.5) * f * (-1 + f * (2 - f));
        w[1] = T(0.5) * (2 + f * f * (-5 + 3 * f));
        w[2] = T(0.5) * f * (1 + f * (4 - 3 * f));
        w[3] = T(0.5) * f * f * (f - 1);
        d[0] = T(0.5) * (-1 + f * (4 - 3 * f));
        d[1] = T(0.5) * f * (-10 + 9 * f);
        d[2] = T(0.5) * (1 + f * (8 - 9 * f));
        d[3] = T(0.5) * f * (3 * f - 2);
    }

    Spot(const T *angles, int64_t rows) {
        const T scale = T(rows / 3.14159265358979323846);
        T u = angles[0] * scale + T(rows) - T(0.5), v = angles[1] * scale - T(0.5);
        T i = std::floor(v), j = std::floor(u);
        weights(v - i, row, d_row);
        weights(u - j, column, d_column);
        for (int k = 0; k < 4; ++k) d_row[k] *= scale, d_column[k] *= scale;
        const int64_t turn = 2 * rows;
        int64_t r = wrapped((int64_t)i - 1, turn);
        const int64_t left = wrapped((int64_t)j - 1, turn);
        for (int a = 0; a < 4; ++a, r = r + 1 == turn ? 0 : r + 1) {
            const bool past = r >= rows;
            int64_t c = past ? left + rows : left;
            if (c >= turn) c -= turn;
            const int64_t start = (past ? turn - 1 - r : r) * turn;
            for (int b = 0; b < 4; ++b, c = c + 1 == turn ? 0 : c + 1) nodes[a][b] = start + c;
        }
    }
};

template <class T> void look_up(int64_t count, int64_t rows, const T *angles, const T *table, T *out, int threads) {
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t p = 0; p < count; ++p) {
        Spot<T> at(angles + 2 * p, rows);
        T total[3] = {0, 0, 0};
        for (int a = 0; a < 4; ++a)
            for (int b = 0; b < 4; ++b) {
                const T *node = table + 3 * at.nodes[a][b];
                const T w = at.row[a] * at.column[b];
                for (int c = 0; c < 3; ++c) total[c] += w * node[c];
            }
        for (int c = 0; c < 3; ++c) out[3 * p + c] = total[c];
    }
}

constexpr int64_t LOOKUP_PARTS = 8;

template <class T>
void look_up_backward(int64_t count, int64_t rows, const T *angles, const T *table, const T *slope, T *d_angles,
                      T *d_table, int threads) {
    const int64_t size = 3 * 2 * rows * rows, step = (count + LOOKUP_PARTS - 1) / LOOKUP_PARTS;
    std::vector<T> partial(d_table ? LOOKUP_PARTS * size : 0, T(0));
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int64_t part = 0; part < LOOKUP_PARTS; ++part) {
        T *into = partial.data() + part * size;
        for (int64_t p = part * step; p < std::min(count, (part + 1) * step); ++p) {
            Spot<T> at(angles + 2 * p, rows);
            const T *g = slope + 3 * p;
            T d_azimuth = 0, d_polar = 0;
            for (int a = 0; a < 4; ++a)
                for (int b = 0; b < 4; ++b) {
                    const int64_t node = 3 * at.nodes[a][b];
                    if (d_angles) {
                        const T along = g[0] * table[node] + g[1] * table[node + 1] + g[2] * table[node + 2];
                        d_azimuth += along * at.row[a] * at.d_column[b];
                        d_polar += along * at.d_row[a] * at.column[b];
                    }
                    if (d_table) {
                        const T w = at.row[a] * at.column[b];
                        for (int c = 0; c < 3; ++c) into[node + c] += w * g[c];
                    }
                }
            if (d_angles) d_angles[2 * p] = d_azimuth, d_angles[2 * p + 1] = d_polar;
        }
    }
    if (d_table)
#pragma omp parallel for schedule(static) num_threads(threads)
        for (int64_t i = 0; i < size; ++i) {
            T total = 0;
            for (int64_t part = 0; part < LOOKUP_PARTS; ++part) total += partial[part * size + i];
            d_table[i] = total;
        }
}

template <class T> void touch(int64_t count, int64_t rows, const T *angles, uint8_t *touched) {
    for (int64_t p = 0; p < count; ++p) {
        Spot<T> at(angles + 2 * p, rows);
        for (int a = 0; a < 4; ++a)
            for (int b = 0; b < 4; ++b) touched[at.nodes[a][b]] = 1;
    }
}

}  // namespace

#define BOTH(T, NAME)                                                                                                  \
    extern "C" void shade_##NAME(const Scene<T> *s, T *out, int threads) {                                             \
        s->channels == 1 ? forward<T, 1>(*s, out, threads) : forward<T, 3>(*s, out, threads);                          \
    }                                                                                                                  \
    extern "C" void shade_backward_##NAME(const Scene<T> *s, const T *slope, T *d_light, T *d_kappa, T *d_gamma,       \
                                          T *d_normals, int threads) {                                                 \
        s->channels == 1 ? backward<T, 1>(*s, slope, d_light, d_kappa, d_gamma, d_normals, threads)                    \
                         : backward<T, 3>(*s, slope, d_light, d_kappa, d_gamma, d_normals, threads);                   \
    }                                                                                                                  \
    extern "C" void transport_##NAME(const Scene<T> *s, T *out, int threads) {                                         \
        s->channels == 1 ? transport<T, 1>(*s, out, threads) : transport<T, 3>(*s, out, threads);                      \
    }                                                                                                                  \
    extern "C" void look_up_##NAME(int64_t count, int64_t rows, const T *angles, const T *table, T *out,               \
                                   int threads) {                                                                      \
        look_up<T>(count, rows, angles, table, out, threads);                                                          \
    }                                                                                                                  \
    extern "C" void look_up_backward_##NAME(int64_t count, int64_t rows, const T *angles, const T *table,              \
                                            const T *slope, T *d_angles, T *d_table, int threads) {                    \
        look_up_backward<T>(count, rows, angles, table, slope, d_angles, d_table, threads);                            \
    }                                                                                                                  \
    extern "C" void touch_##NAME(int64_t count, int64_t rows, const T *angles, uint8_t *touched) {                     \
        touch<T>(count, rows, angles, touched);                                                                        \
    }

BOTH(float, float)
BOTH(double, double)
