// Interpolates tables over normals (services/scene_attack/rendering/torch/table.py).

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "lanes.h"
#include "layout.h"

namespace {

// The 16 nodes around a normal's angles, and the Catmull-Rom weights with their derivatives. A table has its row i at polar
// angle (i + 1/2) h and its column j at azimuth -pi + (j + 1/2) h, with h = pi / rows and 2 * rows columns. Beyond a pole
// the rows repeat in reverse order, shifted by half a turn of azimuth.
template <class T> struct Spot {
    int64_t nodes[4][4], line[4];  // node indices in the flattened table, and row indices
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
            line[a] = past ? turn - 1 - r : r;
            for (int b = 0; b < 4; ++b, c = c + 1 == turn ? 0 : c + 1) nodes[a][b] = line[a] * turn + c;
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
void look_up_backward(int64_t count, int64_t rows, const T *angles, const T *table, const T *d_out, T *d_angles,
                      T *d_table, int threads) {
    const int64_t size = 3 * 2 * rows * rows, step = (count + LOOKUP_PARTS - 1) / LOOKUP_PARTS;
    std::vector<T> partial(d_table ? LOOKUP_PARTS * size : 0, T(0));
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int64_t part = 0; part < LOOKUP_PARTS; ++part) {
        T *into = partial.data() + part * size;
        for (int64_t p = part * step; p < std::min(count, (part + 1) * step); ++p) {
            Spot<T> at(angles + 2 * p, rows);
            const T *g = d_out + 3 * p;
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

constexpr int64_t TILE = 4;  // side of a tile in nodes, as in lookup_table.py

// Marks the tiles that the values at `angles` depend on: those that hold the corners of the 4 x 4 nodes around each pair.
// Threads that mark the same tile write the same value.
template <class T> void touch(int64_t count, int64_t rows, const T *angles, uint8_t *touched, int threads) {
    const int64_t turn = 2 * rows;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t p = 0; p < count; ++p) {
        Spot<T> at(angles + 2 * p, rows);
        for (int a = 0; a < 4; a += 3)
            for (int b = 0; b < 4; b += 3) {
                const int64_t column = at.nodes[a][b] - at.line[a] * turn;
                __atomic_store_n(touched + at.line[a] / TILE * (turn / TILE) + column / TILE, 1, __ATOMIC_RELAXED);
            }
    }
}

}  // namespace

#define BOTH(T, NAME)                                                                                                  \
    EXPORT void look_up_##NAME(int64_t count, int64_t rows, const T *angles, const T *table, T *out, int threads) {    \
        look_up<T>(count, rows, angles, table, out, threads);                                                          \
    }                                                                                                                  \
    EXPORT void look_up_backward_##NAME(int64_t count, int64_t rows, const T *angles, const T *table, const T *d_out,  \
                                        T *d_angles, T *d_table, int threads) {                                        \
        look_up_backward<T>(count, rows, angles, table, d_out, d_angles, d_table, threads);                            \
    }                                                                                                                  \
    EXPORT void touch_##NAME(int64_t count, int64_t rows, const T *angles, uint8_t *touched, int threads) {            \
        touch<T>(count, rows, angles, touched, threads);                                                               \
    }

BOTH(float, float)
BOTH(double, double)
FUNCTION(look_up_float)
FUNCTION(look_up_backward_float)
FUNCTION(touch_float)
FUNCTION(look_up_double)
FUNCTION(look_up_backward_double)
FUNCTION(touch_double)
