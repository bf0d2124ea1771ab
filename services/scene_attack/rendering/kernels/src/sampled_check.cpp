// Choosing the pixels of a looked-up image that are summed too (services/scene_attack/rendering/torch/table.py).

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <type_traits>
#include <vector>

#include "lanes.h"
#include "layout.h"

namespace {

constexpr int64_t SIDE = 4;    // nodes a side of a tile, as in lookup_table.py
constexpr int64_t BORDER = 3;  // nodes beyond the table: two for a fourth difference and one for the neighbour

// A table's nodes in one channel, their sum, with a border on which it continues; not a number where none is filled.
template <class T> struct Bordered {
    int64_t rows, turn, width, height;
    std::vector<T> values;

    Bordered(int64_t rows, const T *table, const uint8_t *filled)
        : rows(rows), turn(2 * rows), width(turn + 2 * BORDER), height(rows + 2 * BORDER),
          values(width * height, std::numeric_limits<T>::quiet_NaN()) {
        for (int64_t i = 0; i < rows; ++i) {
            const uint8_t *tile = filled + i / SIDE * (turn / SIDE);
            for (int64_t first = 0; first < turn; first += SIDE)
                if (tile[first / SIDE])
                    for (int64_t j = first; j < first + SIDE; ++j) {
                        const T *node = table + 3 * (i * turn + j);
                        line(i)[j] = node[0] + node[1] + node[2];
                    }
        }
        for (int64_t k = 0; k < BORDER; ++k) {  // past a pole: rows come back half a turn further round
            half_turned(line(k), line(-1 - k));
            half_turned(line(rows - 1 - k), line(rows + k));
        }
        for (int64_t i = -BORDER; i < rows + BORDER; ++i)
            for (int64_t k = 1; k <= BORDER; ++k) line(i)[-k] = line(i)[turn - k], line(i)[turn - 1 + k] = line(i)[k - 1];
    }

    T *line(int64_t i) { return values.data() + (i + BORDER) * width + BORDER; }

    void half_turned(const T *from, T *to) const {
        std::copy(from + rows, from + turn, to);
        std::copy(from, from + rows, to + rows);
    }
};

template <class T> inline T larger(T a, T b) { return a > b ? a : b; }
template <class T> inline T size_of(T x) { return x == x ? std::abs(x) : T(0); }

// From the first to behind the last filled column of a tile's rows.
struct Span {
    int64_t from = std::numeric_limits<int64_t>::max(), to = 0;

    void join(Span other) { from = std::min(from, other.from), to = std::max(to, other.to); }
};

inline std::vector<Span> spans_of(int64_t rows, const uint8_t *filled) {
    const int64_t across = 2 * rows / SIDE;
    std::vector<Span> spans(rows / SIDE);
    for (int64_t band = 0; band < rows / SIDE; ++band)
        for (int64_t k = 0; k < across; ++k)
            if (filled[band * across + k]) spans[band].join({k * SIDE, (k + 1) * SIDE});
    return spans;
}

// The largest second and fourth differences along both angles, among each node and its eight neighbours: uneven [2, nodes],
// zero outside the spans.
template <class T> void unevenness(int64_t rows, const T *table, const uint8_t *filled, T *uneven) {
    Bordered<T> of(rows, table, filled);
    const std::vector<Span> spans = spans_of(rows, filled);
    const int64_t turn = of.turn, width = turn + 2, orders = (rows + 2) * width;  // one neighbour at either end
    const std::unique_ptr<T[]> of_nodes(new T[2 * orders]);                       // read only where it is written
    std::vector<T> across(width);
    for (int64_t i = -1; i <= rows; ++i) {
        Span span;
        for (int64_t k = -1; k <= 1; ++k) span.join(spans[std::clamp<int64_t>(i + k, 0, rows - 1) / SIDE]);
        const T *v[5];
        for (int k = 0; k < 5; ++k) v[k] = of.line(std::clamp(i + k - 2, -BORDER, rows + BORDER - 1)) - 1;
        T *second = of_nodes.get() + (i + 1) * width, *fourth = second + orders;
        for (int64_t j = span.from; j < span.to + 2; ++j) {
            const T *c = v[2] + j;
            const T twice = c[-1] + c[1] - 2 * c[0], before = c[-2] + c[0] - 2 * c[-1], after = c[0] + c[2] - 2 * c[1];
            const T down = v[1][j] + v[3][j] - 2 * c[0], above = v[0][j] + c[0] - 2 * v[1][j];
            const T below = c[0] + v[4][j] - 2 * v[3][j];
            second[j] = larger(size_of(twice), size_of(down));
            fourth[j] = larger(size_of(before + after - 2 * twice), size_of(above + below - 2 * down));
        }
    }
    std::fill(uneven, uneven + 2 * rows * turn, T(0));
    for (int order = 0; order < 2; ++order)
        for (int64_t i = 0; i < rows; ++i) {
            const Span span = spans[i / SIDE];
            const T *a = of_nodes.get() + order * orders + i * width, *b = a + width, *c = b + width;
            T *out = uneven + (order * rows + i) * turn;
            for (int64_t j = span.from; j < span.to + 2; ++j) across[j] = larger(a[j], larger(b[j], c[j]));
            for (int64_t j = span.from; j < span.to; ++j) out[j] = larger(across[j], larger(across[j + 1], across[j + 2]));
        }
}

// k modulo `turn`, whole numbers of less than 2^24; 0 where that cannot be told.
template <class T> inline T modulo(T k, T turn) {
    const T rest = k - turn * std::floor(k / turn);
    return rest > 0 && rest < turn ? rest : T(0);
}

// The node nearest to azimuth and polar angle, as a place in the flattened table.
template <class T> inline int32_t nearest(const T *angles, int64_t rows) {
    const T scale = T(rows / 3.14159265358979323846), most = T(rows), turn = 2 * most;
    const T row = modulo<T>(std::floor(angles[1] * scale), turn);
    const bool past = row >= most;
    const T column = modulo<T>(std::floor(angles[0] * scale + most) + (past ? most : T(0)), turn);
    return (int32_t)((past ? turn - 1 - row : row) * turn + column);
}

// The largest of the scores that are offered in the order of their pixels; of equal ones the first.
template <class T> struct Largest {
    struct Scored {
        T score;
        int64_t pixel;
        bool operator<(const Scored &other) const {  // so that the least of a heap is in front
            return score != other.score ? score > other.score : pixel < other.pixel;
        }
    };
    std::vector<Scored> kept;
    size_t most;

    explicit Largest(int64_t most) : most(most) { kept.reserve(most); }

    void offer(T score, int64_t pixel) {
        if (score != score) score = std::numeric_limits<T>::infinity();  // what is not a number is checked first
        if (kept.size() < most) {
            kept.push_back({score, pixel});
            std::push_heap(kept.begin(), kept.end());
        } else if (score > kept.front().score) {
            std::pop_heap(kept.begin(), kept.end());
            kept.back() = {score, pixel};
            std::push_heap(kept.begin(), kept.end());
        }
    }
};

constexpr int64_t AT_ONCE = 256;  // pixels, whose values stay in the first-level cache

// chosen [most] takes the indices, ascending, and found their number. `third` pixels each have the largest second and
// fourth differences times the steepness of the display's curve; the others are spread evenly. most < count.
template <class T>
void choose_pixels(int64_t most, int64_t third, int64_t count, int64_t rows, T knee, const T *uneven, const T *angles,
                   const T *shaded, const T *base_color, int64_t *chosen, int64_t *found, int threads) {
    const int64_t nodes = 2 * rows * rows, even = most - 2 * third, stride = count / even;
    const std::unique_ptr<T[]> scores(new T[2 * count]);
    // The start of those spread evenly changes with the image: the sum of its bits, which no order of summing changes.
    typedef std::conditional_t<sizeof(T) == 4, int32_t, int64_t> Bits;
    uint64_t sum = 0;
#pragma omp parallel for schedule(static) num_threads(threads) reduction(+ : sum)
    for (int64_t first = 0; first < count; first += AT_ONCE) {
        const int64_t here = std::min(AT_ONCE, count - first);
        T steepness[3 * AT_ONCE];
        for (int64_t i = 0; i < 3 * here; ++i) {
            const T color = base_color[3 * first + i], radiance = shaded[3 * first + i], linear = radiance * color;
            const T held = linear <= 0 ? T(0) : linear >= 1 ? T(1) : linear;
            steepness[i] = color / std::sqrt(held + knee);
            Bits bits;
            std::memcpy(&bits, &radiance, sizeof bits);
            sum += (uint64_t)(int64_t)bits;
        }
        int32_t places[AT_ONCE];
        for (int64_t i = 0; i < here; ++i) places[i] = nearest<T>(angles + 2 * (first + i), rows);
        for (int64_t i = 0; i < here; ++i) {
            const T *of = steepness + 3 * i, *node = uneven + places[i];
            const T unknown = 0 * (of[0] + of[1] + of[2]);  // not a number where a channel is not
            const T steepest = larger(of[0], larger(of[1], of[2])) + unknown;
            scores[first + i] = node[0] * steepest, scores[count + first + i] = node[nodes] * steepest;
        }
    }
    for (int order = 0; order < 2 && third; ++order) {
        Largest<T> largest(third);
        for (int64_t p = 0; p < count; ++p) largest.offer(scores[order * count + p], p);
        for (const auto &one : largest.kept) *chosen++ = one.pixel;
    }
    const int64_t start = ((int64_t)sum % stride + stride) % stride;
    for (int64_t k = 0; k < even; ++k) *chosen++ = start + k * stride;
    std::sort(chosen - most, chosen);
    *found = std::unique(chosen - most, chosen) - (chosen - most);
}

}  // namespace

#define BOTH(T, NAME)                                                                                                  \
    EXPORT void unevenness_##NAME(int64_t rows, const T *table, const uint8_t *filled, T *uneven) {                    \
        unevenness<T>(rows, table, filled, uneven);                                                                    \
    }                                                                                                                  \
    EXPORT void choose_pixels_##NAME(int64_t most, int64_t third, int64_t count, int64_t rows, T knee, const T *uneven,\
                                     const T *angles, const T *shaded, const T *base_color, int64_t *chosen,           \
                                     int64_t *found, int threads) {                                                    \
        choose_pixels<T>(most, third, count, rows, knee, uneven, angles, shaded, base_color, chosen, found, threads);  \
    }

BOTH(float, float)
BOTH(double, double)
FUNCTION(unevenness_float)
FUNCTION(choose_pixels_float)
FUNCTION(unevenness_double)
FUNCTION(choose_pixels_double)
