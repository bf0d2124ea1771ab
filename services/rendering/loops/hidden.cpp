// Which faces of a scene need to be drawn (services/rendering/hidden.py). Whatever the rasteriser rounds, a face that is
// left out covers no sample, or changes nothing at the samples it covers: there it is behind all that shows in the block
// of 2 x 2 pixels that is shaded at once.
//
// Behind what shows at the sample is not enough. Where a face is drawn before those that hide it, others that show at the
// block's other samples may find the sample taken, and are then shaded at another place (centroid), in all four pixels.
//
// Corners are projected in double. The rasteriser has them in float32 and puts them on a grid of 1/256 of a pixel; so a
// face hides samples only where it covers them with its corners moved by that much, and itself counts as covering a
// sample that it covers with its corners moved so. Depths get a margin likewise.

#include <atomic>
#include <thread>

#include "lanes.h"

namespace {

constexpr int SAMPLES = 4, SIDE = 2, LANES = SAMPLES * SIDE * SIDE;  // of a pixel; pixels; of a block
typedef float Samples __attribute__((vector_size(LANES * sizeof(float))));
typedef int32_t Mask __attribute__((vector_size(LANES * sizeof(int32_t))));

constexpr double GRID = 1.0 / 256;
constexpr double ROUNDING = 1.0 / (1 << 21);  // eight times float32's, of everything that is added up
constexpr double FAR_OFF = 0.25;  // pixels; where corners may be further off, nothing is left out
constexpr float NOWHERE = 1e30f;

struct Piece {
    int64_t corners, faces;
    const float *positions;  // [corners, 3]
    const int32_t *triangles;  // [faces, 3]
    int64_t opaque;
};

struct Frame {
    int64_t width, height;
    double x[SAMPLES], y[SAMPLES];  // where in a pixel its samples are, from the lower left
};

// Corners in pixels from the lower left and depth in [0, 1], and how far the rasteriser's may be off.
struct Corners {
    std::vector<double> x, y, z, off, z_off;
    bool known = true;  // all of them, and none is before the near plane, where the rasteriser cuts faces

    Corners(const Piece &piece, const float *matrix, const Frame &frame)
        : x(piece.corners), y(piece.corners), z(piece.corners), off(piece.corners), z_off(piece.corners) {
        double m[16], a[16];
        for (int i = 0; i < 16; ++i) m[i] = matrix[i], a[i] = std::fabs(m[i]);
        const double width = frame.width, height = frame.height;
        const float *positions = piece.positions;
        int64_t bad = 0;
#pragma omp simd reduction(+ : bad)
        for (int64_t v = 0; v < piece.corners; ++v) {
            const double px = positions[3 * v], py = positions[3 * v + 1], pz = positions[3 * v + 2];
            const double ax = std::fabs(px), ay = std::fabs(py), az = std::fabs(pz);
            const double cw = m[12] * px + m[13] * py + m[14] * pz + m[15];
            const double cz = m[8] * px + m[9] * py + m[10] * pz + m[11];
            const double w = 1 / cw;
            const double nx = (m[0] * px + m[1] * py + m[2] * pz + m[3]) * w;
            const double ny = (m[4] * px + m[5] * py + m[6] * pz + m[7]) * w;
            const double nz = cz * w;
            // the sizes of what is added up
            const double sw = a[12] * ax + a[13] * ay + a[14] * az + a[15];
            const double sx = (a[0] * ax + a[1] * ay + a[2] * az + a[3] + std::fabs(nx) * sw) * w + 1;
            const double sy = (a[4] * ax + a[5] * ay + a[6] * az + a[7] + std::fabs(ny) * sw) * w + 1;
            const double sz = (a[8] * ax + a[9] * ay + a[10] * az + a[11] + std::fabs(nz) * sw) * w + 1;
            x[v] = (nx + 1) / 2 * width, y[v] = (ny + 1) / 2 * height, z[v] = (nz + 1) / 2;
            off[v] = GRID + ROUNDING * (sx * width + sy * height);
            z_off[v] = ROUNDING * sz;
            bad += !(cw > 2 * ROUNDING * sw && cz > -cw && off[v] < FAR_OFF);  // nor what is not a number
        }
        known = bad == 0;
    }
};

// A face over the grid of samples, seen from the lower left corner of the blocks it may touch: numbers stay small, and
// float32 is off by less than the slacks.
struct Face {
    int32_t piece, number;
    bool hides, thin, shows = false;
    int32_t bottom, top, left, right;  // blocks from, to
    float low_x, high_x, low_y, high_y;
    float slack;  // how far an edge's function may be off
    float e0[3], ex[3], ey[3];  // edge functions, positive inside
    float z0, zx, zy, z_slack;
    float nearest;  // depth that no sample of it has less of

    // Of a block's samples, those inside all edges, moved inward by the slack.
    Mask surely(Samples x, Samples y) const {
        Mask found = e0[0] + ex[0] * x + ey[0] * y >= slack;
        for (int i = 1; i < 3; ++i) found &= e0[i] + ex[i] * x + ey[i] * y >= slack;
        return found;
    }

    // Those that may be covered.
    Mask perhaps(Samples x, Samples y) const {
        Mask found = (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y);
        for (int i = 0; i < 3; ++i) found &= e0[i] + ex[i] * x + ey[i] * y >= -slack;
        return found;
    }

    Samples depth(Samples x, Samples y) const { return z0 + zx * x + zy * y; }

    // The columns from and to, counted from `left`, in which the edges leave something of the row that begins at y.
    void span(float y, int32_t &from, int32_t &to) const {
        float first = 0, last = float(right - left);
        if (!thin && right - left > 3)  // else it takes longer than it saves
            for (int i = 0; i < 3; ++i) {
                const float most = e0[i] + ey[i] * (ey[i] > 0 ? y + SIDE : y) + slack;
                if (ex[i] > 0) first = std::max(first, -most / ex[i] / SIDE);
                if (ex[i] < 0) last = std::min(last, most / -ex[i] / SIDE + 1);
            }
        from = (int32_t)first, to = (int32_t)std::min(last, float(right - left));
    }
};

inline bool any(Mask m) {
    typedef int64_t Wide __attribute__((vector_size(sizeof(Mask))));
    const Wide wide = (Wide)m;
    int64_t found = 0;
    for (int i = 0; i < LANES / 2; ++i) found |= wide[i];
    return found != 0;
}
inline Samples either(Mask mask, Samples yes, Samples no) { return (Samples)((mask & (Mask)yes) | (~mask & (Mask)no)); }

// A part of a picture: rows from, to, columns from, to, in blocks. Of each sample the furthest that may be seen there;
// and of each block the furthest that what may be seen in it has at any of its samples.
struct Picture {
    int64_t rows[2], columns[2];
    Samples x, y;
    std::vector<Samples> seen, reached;
    std::vector<float> furthest;

    Picture(const Frame &frame, const int64_t *part)
        : rows{part[0] / SIDE, (part[1] + SIDE - 1) / SIDE}, columns{part[2] / SIDE, (part[3] + SIDE - 1) / SIDE},
          seen((rows[1] - rows[0]) * (columns[1] - columns[0]), Samples{} + NOWHERE),
          reached(seen.size(), Samples{} - NOWHERE), furthest(seen.size()) {
        for (int i = 0; i < LANES; ++i) {
            const int pixel = i / SAMPLES;
            x[i] = pixel % SIDE + frame.x[i % SAMPLES], y[i] = pixel / SIDE + frame.y[i % SAMPLES];
        }
    }

    int64_t place(int32_t row, int32_t column) const {
        return (row - rows[0]) * (columns[1] - columns[0]) + column - columns[0];
    }

    // The samples of each block that a face may touch, until one asks to stop.
    template <class Visit> bool visit(const Face &face, Visit visit) {
        for (int32_t row = face.bottom; row < face.top; ++row) {
            const int64_t first = place(row, face.left);
            const float low = float(SIDE * (row - face.bottom));
            int32_t from, to;
            face.span(low, from, to);
            for (int32_t column = from; column < to; ++column)
                if (visit(first + column, x + float(SIDE * column), y + low)) return true;
        }
        return false;
    }

    void hide_behind(const Face &face) {
        visit(face, [&](int64_t block, Samples px, Samples py) {
            const Samples z = face.depth(px, py) + face.z_slack, known = seen[block];
            seen[block] = either(face.surely(px, py) & (z < known), z, known);
            return false;
        });
    }

    // Whether everywhere in the rectangle around a face, what is known of the blocks is nearer.
    bool behind(const Face &face) const {
        bool found = true;
        for (int32_t row = face.bottom; row < face.top && found; ++row) {
            const float *known = furthest.data() + place(row, 0);
            float most = -NOWHERE;
            for (int32_t column = face.left; column < face.right; ++column) most = std::max(most, known[column]);
            found = most < face.nearest;
        }
        return found;
    }

    // Whether a face may be seen; and if so, how far it reaches in the blocks where it may.
    void look_at(Face &face) {
        visit(face, [&](int64_t block, Samples px, Samples py) {
            const Mask inside = face.perhaps(px, py);
            const Samples z = face.depth(px, py);
            if (!any(inside & (z - face.z_slack <= seen[block]))) return false;
            face.shows = true;
            const Samples far = z + face.z_slack, known = reached[block];
            reached[block] = either(inside & (far > known), far, known);
            return false;
        });
    }

    // Takes the largest of a block's samples as what is known of it.
    void sum_up(const std::vector<Samples> &samples) {
        for (size_t i = 0; i < furthest.size(); ++i) {
            furthest[i] = samples[i][0];
            for (int k = 1; k < LANES; ++k) furthest[i] = std::max(furthest[i], samples[i][k]);
        }
    }

    // Whether a face that is not seen may matter to one that is.
    bool matters(const Face &face) {
        return visit(face, [&](int64_t block, Samples px, Samples py) {
            return any(face.perhaps(px, py) & (face.depth(px, py) - face.z_slack <= furthest[block]));
        });
    }
};

// Makes `face` of three corners; false if it covers no sample, or shows its inside and has none.
bool make(Face &face, const Corners &of, const int32_t *t, bool closed, const Frame &frame,
          const Picture &picture) {
    double x[3], y[3], z[3], off = 0, z_off = 0;
    for (int k = 0; k < 3; ++k) {
        x[k] = of.x[t[k]], y[k] = of.y[t[k]];
        off = std::max(off, of.off[t[k]]);
    }
    const double low_x = std::min({x[0], x[1], x[2]}) - off, high_x = std::max({x[0], x[1], x[2]}) + off;
    const double low_y = std::min({y[0], y[1], y[2]}) - off, high_y = std::max({y[0], y[1], y[2]}) + off;
    auto block = [](double at, const int64_t *within) {
        return (int32_t)std::floor(std::min(std::max(at / SIDE, double(within[0])), double(within[1])));
    };
    face.bottom = block(low_y, picture.rows), face.top = block(high_y + SIDE, picture.rows);
    face.left = block(low_x, picture.columns), face.right = block(high_x + SIDE, picture.columns);
    if (face.bottom >= face.top || face.left >= face.right) return false;
    const double corner_x = SIDE * face.left, corner_y = SIDE * face.bottom;
    face.low_x = low_x - corner_x - ROUNDING, face.high_x = high_x - corner_x + ROUNDING;
    face.low_y = low_y - corner_y - ROUNDING, face.high_y = high_y - corner_y + ROUNDING;
    if (face.top == face.bottom + 1 && face.right == face.left + 1) {
        const Mask across = (picture.x >= face.low_x) & (picture.x <= face.high_x);
        if (!any(across & (picture.y >= face.low_y) & (picture.y <= face.high_y))) return false;
    }
    const double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);  // twice, > 0 counter-clockwise
    // Both ends of an edge, and what is at most a diagonal away from them, may be off by D.
    const double D = 1.4143 * off, high = high_y - low_y, wide = high_x - low_x;
    const double slack = D * (3 * std::sqrt(high * high + wide * wide) + 2 * D);
    face.thin = !(std::fabs(area) > 2 * slack);
    face.hides = false;
    if (face.thin) {  // its depth may be anything
        for (int i = 0; i < 3; ++i) face.e0[i] = face.ex[i] = face.ey[i] = 0;
        face.z0 = face.zx = face.zy = 0, face.z_slack = NOWHERE, face.slack = 0, face.nearest = -NOWHERE;
        return true;
    }
    if (closed && area < 0) return false;
    for (int k = 0; k < 3; ++k) {
        x[k] -= corner_x, y[k] -= corner_y, z[k] = of.z[t[k]];
        z_off = std::max(z_off, of.z_off[t[k]]);
    }
    const double turn = area > 0 ? 1 : -1, per_area = 1 / area;
    for (int i = 0, j = 1; i < 3; ++i, j = (j + 1) % 3) {
        const double ex = turn * (y[i] - y[j]), ey = turn * (x[j] - x[i]);
        face.ex[i] = ex, face.ey[i] = ey, face.e0[i] = -ex * x[i] - ey * y[i];
    }
    const double zx = ((z[1] - z[0]) * (y[2] - y[0]) - (z[2] - z[0]) * (y[1] - y[0])) * per_area;
    const double zy = ((z[2] - z[0]) * (x[1] - x[0]) - (z[1] - z[0]) * (x[2] - x[0])) * per_area;
    const double nearest = std::min({z[0], z[1], z[2]}), furthest = std::max({z[0], z[1], z[2]});
    z_off += ROUNDING;
    face.slack = slack, face.zx = zx, face.zy = zy, face.z0 = z[0] - zx * x[0] - zy * y[0];
    face.z_slack = z_off + 2 * (furthest - nearest) * slack * std::fabs(per_area) +
                   (std::fabs(zx) + std::fabs(zy)) * (D + ROUNDING * (frame.width + frame.height));
    // Within its corners' depths but for the slack: beyond the edges, by at most which its plane may be asked, too.
    face.nearest = nearest - 2 * face.z_slack;
    // What is cut at a border is not where it would be by a rounding; nor is it drawn beyond the far plane.
    face.hides = nearest > z_off && furthest < 1 - z_off && low_x >= 0 && low_y >= 0 && high_x <= frame.width &&
                 high_y <= frame.height;
    return true;
}

// One pass: matrices [pieces, 16], clip from object; closed [pieces], of each piece's faces the first so many have no
// inside; kept: triangles [., 3] of all pieces one after another; counts [pieces, 2], of closed ones and others.
void pass(int64_t pieces, const Piece *piece, const Frame &frame, const float *matrices, const int64_t *closed,
          const int64_t *part, int32_t *kept, int64_t *counts) {
    Picture picture(frame, part);
    std::vector<Face> faces;
    bool known = true;
    for (int64_t i = 0; i < pieces && known; ++i) {
        const Corners corners(piece[i], matrices + 16 * i, frame);
        known = corners.known;
        for (int64_t f = 0; f < piece[i].faces && known; ++f) {
            Face face;
            if (!make(face, corners, piece[i].triangles + 3 * f, f < closed[i], frame, picture)) continue;
            face.piece = i, face.number = f;
            face.hides &= piece[i].opaque != 0;
            faces.push_back(face);
        }
    }
    std::fill(counts, counts + 2 * pieces, 0);
    auto keep = [&](int64_t i, int64_t f) {
        const int32_t *t = piece[i].triangles + 3 * f;
        kept = std::copy(t, t + 3, kept);
        ++counts[2 * i + (f >= closed[i])];
    };
    if (!known) {
        for (int64_t i = 0; i < pieces; ++i)
            for (int64_t f = 0; f < piece[i].faces; ++f) keep(i, f);
        return;
    }
    for (const Face &face : faces)
        if (face.hides) picture.hide_behind(face);
    picture.sum_up(picture.seen);
    for (Face &face : faces)
        if (!picture.behind(face)) picture.look_at(face);
    picture.sum_up(picture.reached);
    for (const Face &face : faces)
        if (face.shows || (!picture.behind(face) && picture.matters(face))) keep(face.piece, face.number);
}

}  // namespace

EXPORT void seen_float(int64_t passes, int64_t pieces, int64_t faces, const Piece *piece, const Frame *frame,
                       const float *matrices, const int64_t *closed, const int64_t *parts, int32_t *kept,
                       int64_t *counts, int threads) {
    // Threads of their own, which end: those of OpenMP wait for more work on the cores that now draw.
    std::atomic<int64_t> next{0};
    auto work = [&] {
        for (int64_t p; (p = next++) < passes;)
            pass(pieces, piece, *frame, matrices + 16 * pieces * p, closed + pieces * p, parts + 4 * p,
                 kept + 3 * faces * p, counts + 2 * pieces * p);
    };
    std::vector<std::thread> others;
    for (int64_t k = 1; k < std::min<int64_t>(threads, passes); ++k) others.emplace_back(work);
    work();
    for (std::thread &other : others) other.join();
}
