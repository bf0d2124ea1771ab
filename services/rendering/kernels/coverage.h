// Which samples of a picture each face of a scene takes, as llvmpipe finds it.
//
// Corners are float32 and are put on a grid of 1/256 of a pixel; edges are integers, with the top-left rule. Depths and
// attributes are planes over the picture, counted from its lower left corner. A face takes the samples at which it is
// nearest when its turn comes. It is shaded once a pixel: in the middle if it took all samples, else at the first it
// took; only its normal and texture are looked at there.

#pragma once

#include <optional>

#include "texture.h"

namespace {

constexpr int SAMPLES = 4, SIDE = 2, PIXELS = SIDE * SIDE;  // of a pixel; of a block in pixels
static_assert(WIDTH == SAMPLES * PIXELS, "a vector is a block's samples");
constexpr int MIDDLE = SAMPLES;  // of a pixel, where a sample would be named
constexpr int GRID = 256;
constexpr int SMALL = 64;  // pixels a side, up to which edges fit 32 bits
constexpr int32_t NONE = -1;

struct Piece {
    static std::string layout_name() { return "Piece"; }

    int64_t corners, faces;
    const float *positions, *normals, *uv;  // [corners, 3], [corners, 3], [corners, 2]
    const int32_t *triangles;  // [faces, 3]
    int64_t holes, blended;
    double opacity;
    Texture texture;
};

struct Frame {
    static std::string layout_name() { return "Frame"; }

    int64_t width, height, pieces;
    const Piece *piece;
    double x[SAMPLES], y[SAMPLES];  // where in a pixel its samples are, from the lower left
    double eye[3];
};

struct Pass {
    static std::string layout_name() { return "Pass"; }

    const float *clip, *world, *normal;  // [pieces, 16], [pieces, 16], [pieces, 9], from the object
    const int64_t *order, *closed;  // [pieces], as drawn; of each piece's faces the first so many have no inside
    int64_t part[4];  // rows from the bottom from, to, columns from, to
    int64_t pictures, lights;
    const float *ambients, *points, *colors;  // [pictures], [pictures, lights, 4], [pictures, pieces, 3]
    float *images;  // [pictures, rows, columns, 4]
    int64_t drawn;  // 0: something is cut by the frame or the near plane, and nothing was drawn
    int64_t shown;  // faces
};

// Position, normal and texture coordinates.
typedef float Channels __attribute__((vector_size(8 * sizeof(float))));
inline Channels fuse(Channels a, float b, Channels c) {
    Channels r;
    for (int i = 0; i < 8; ++i) r[i] = fuse(a[i], b, c[i]);
    return r;
}

// The corners of a piece: in pixels from the lower left, on the grid, depth; 1 / w, and the channels over w.
struct Corners {
    std::vector<float> x, y, z, w;
    std::vector<int32_t> grid_x, grid_y;
    std::vector<Channels> values;
    bool whole = true;  // none is outside of the frustum

    Corners(const Piece &piece, const float *m, const float *world, const float *turn, const Frame &frame)
        : x(piece.corners), y(piece.corners), z(piece.corners), w(piece.corners), grid_x(piece.corners),
          grid_y(piece.corners), values(piece.corners) {
        const float half_width = frame.width / 2.0f, half_height = frame.height / 2.0f;
        int32_t outside = 0;
#pragma omp simd reduction(| : outside)
        for (int64_t i = 0; i < piece.corners; ++i) {
            const float px = piece.positions[3 * i], py = piece.positions[3 * i + 1], pz = piece.positions[3 * i + 2];
            const float cx = ((m[0] * px + m[1] * py) + m[2] * pz) + m[3];
            const float cy = ((m[4] * px + m[5] * py) + m[6] * pz) + m[7];
            const float cz = ((m[8] * px + m[9] * py) + m[10] * pz) + m[11];
            const float cw = ((m[12] * px + m[13] * py) + m[14] * pz) + m[15];
            outside |= !((cx <= cw) & (cx >= -cw) & (cy <= cw) & (cy >= -cw) & (cz <= cw) & (cz >= -cw) & (cw > 0));
            w[i] = 1.0f / cw;
            x[i] = fuse(cx * w[i], half_width, half_width), y[i] = fuse(cy * w[i], half_height, half_height);
            z[i] = fuse(cz * w[i], 0.5f, 0.5f);
            grid_x[i] = (int32_t)std::nearbyint(x[i] * GRID), grid_y[i] = (int32_t)std::nearbyint(y[i] * GRID);
        }
        whole = !outside;
        for (int64_t i = 0; i < piece.corners && whole; ++i) {
            const float *p = piece.positions + 3 * i, *n = piece.normals + 3 * i;
            for (int k = 0; k < 3; ++k) {
                const float *a = world + 4 * k, *b = turn + 3 * k;
                values[i][k] = (((a[0] * p[0] + a[1] * p[1]) + a[2] * p[2]) + a[3]) * w[i];
                values[i][3 + k] = ((b[0] * n[0] + b[1] * n[1]) + b[2] * n[2]) * w[i];
            }
            for (int k = 0; k < 2; ++k) values[i][6 + k] = piece.uv ? piece.uv[2 * i + k] * w[i] : 0;
        }
    }
};

// Planes over three corners: their slopes, and their values at the picture's corner.
struct Slopes {
    float x0, y0, dx01, dx20, dy01, dy20;

    Slopes(const Corners &of, const int32_t *t) : x0(of.x[t[0]]), y0(of.y[t[0]]) {
        dx01 = x0 - of.x[t[1]], dx20 = of.x[t[2]] - x0, dy01 = y0 - of.y[t[1]], dy20 = of.y[t[2]] - y0;
        const float per_area = 1.0f / (dx01 * dy20 - dy01 * dx20);
        dx01 *= per_area, dx20 *= per_area, dy01 *= per_area, dy20 *= per_area;
    }
};

template <class T> struct Plane {
    T start, along_x, along_y;

    Plane(const Slopes &s, T a, T b, T c) {
        const T ab = a - b, ca = c - a;
        along_x = ab * s.dy20 - ca * s.dy01;
        along_y = ca * s.dx01 - ab * s.dx20;
        start = a - (along_x * s.x0 + along_y * s.y0);
    }
    T at(float x, float y) const { return fuse(along_y, y, fuse(along_x, x, start)); }
};

// All that a face is shaded by, at places in the picture; over w there, whose inverse is taken in a pixel's middle.
struct Surface {
    Plane<float> w;
    Plane<Channels> channels;

    Surface(const Corners &of, const int32_t *t) : Surface(Slopes(of, t), of, t) {}
    Surface(const Slopes &slopes, const Corners &of, const int32_t *t)
        : w(slopes, of.w[t[0]], of.w[t[1]], of.w[t[2]]),
          channels(slopes, of.values[t[0]], of.values[t[1]], of.values[t[2]]) {}
};

// What a face took of a block.
struct Taken {
    int32_t face, row, column;  // the block's
    uint32_t samples;  // a bit for each
    uint8_t places[PIXELS];  // where each pixel is shaded: a sample or MIDDLE
};

typedef int64_t Longs __attribute__((vector_size(WIDTH * sizeof(int64_t))));

// Three edges over the samples of blocks: functions of the place, positive inside.
template <class I, class Vector> struct Edges {
    Vector at[3];
    I start[3], right[3], up[3], most[3];

    Edges(const int32_t *x, const int32_t *y, const int64_t *box, const Vector &sample_x, const Vector &sample_y) {
        for (int i = 0, j = 1; i < 3; ++i, j = (j + 1) % 3) {
            const int64_t ex = y[j] - y[i], ey = x[i] - x[j];
            const int64_t tie = ex > 0 || (ex == 0 && ey >= 0), block = GRID * SIDE;
            start[i] = (I)(ex * (block * box[0] - x[i]) + ey * (block * box[2] - y[i]) + tie);
            at[i] = sample_x * (I)ex + sample_y * (I)ey;
            right[i] = (I)(ex * block), up[i] = (I)(ey * block);
            most[i] = (I)(block * (std::max<int64_t>(ex, 0) + std::max<int64_t>(ey, 0)));
        }
    }
};

// A part of a picture: rows from, to, columns from, to, in blocks.
struct Picture {
    const Frame &frame;
    int64_t rows[2], columns[2];
    Floats x, y;
    Ints grid_x, grid_y;
    float place_x[SAMPLES + 1], place_y[SAMPLES + 1];  // in a pixel, of its samples and its middle
    std::vector<Floats> depth;
    std::vector<Ints> top;  // of each sample, the one of `taken` that it shows
    std::vector<Taken> taken, layers;  // of opaque faces; of others, in the order they are laid over

    Picture(const Frame &frame, const int64_t *part)
        : frame(frame), rows{part[0] / SIDE, (part[1] + SIDE - 1) / SIDE},
          columns{part[2] / SIDE, (part[3] + SIDE - 1) / SIDE},
          depth((rows[1] - rows[0]) * (columns[1] - columns[0]), Floats{} + 1.0f), top(depth.size(), Ints{} + NONE) {
        for (int i = 0; i < WIDTH; ++i) {
            const int pixel = i / SAMPLES, s = i % SAMPLES;
            x[i] = pixel % SIDE + float(frame.x[s]), y[i] = pixel / SIDE + float(frame.y[s]);
            grid_x[i] = int32_t(std::lround(GRID * (pixel % SIDE + frame.x[s])));
            grid_y[i] = int32_t(std::lround(GRID * (pixel / SIDE + frame.y[s])));
        }
        for (int s = 0; s <= SAMPLES; ++s)
            place_x[s] = s == MIDDLE ? 0.5f : frame.x[s], place_y[s] = s == MIDDLE ? 0.5f : frame.y[s];
    }

    int64_t block(int64_t row, int64_t column) const {
        return (row - rows[0]) * (columns[1] - columns[0]) + column - columns[0];
    }

    // Of a block, what its four pixels see of a face's texture at a pixel.
    Texel texel(const Texture &texture, const Surface &surface, const Taken &of, int pixel) const {
        float u[PIXELS], v[PIXELS];
        for (int p = 0; p < PIXELS; ++p) {
            const float px = SIDE * of.column + p % SIDE, py = SIDE * of.row + p / SIDE;
            const float w = 1.0f / surface.w.at(px + 0.5f, py + 0.5f);
            const Channels at = surface.channels.at(px + place_x[of.places[p]], py + place_y[of.places[p]]);
            u[p] = at[6] * w, v[p] = at[7] * w;
        }
        return sample(texture, u, v, pixel);
    }

    // A face of corners `t`, which it puts in the order that has the face on the right side of its edges. False if it
    // has no area, or is seen from inside and has no inside.
    bool draw(const Piece &piece, const Corners &of, int32_t *t, bool closed, int32_t face) {
        const int64_t area = int64_t(of.grid_x[t[0]] - of.grid_x[t[1]]) * (of.grid_y[t[2]] - of.grid_y[t[0]]) -
                             int64_t(of.grid_x[t[2]] - of.grid_x[t[0]]) * (of.grid_y[t[0]] - of.grid_y[t[1]]);
        if (area == 0 || (area > 0 && closed)) return false;
        if (area < 0) std::swap(t[0], t[1]);
        const int32_t gx[3] = {of.grid_x[t[0]], of.grid_x[t[1]], of.grid_x[t[2]]};
        const int32_t gy[3] = {of.grid_y[t[0]], of.grid_y[t[1]], of.grid_y[t[2]]};
        // pixels from, to
        const int64_t left = std::min({gx[0], gx[1], gx[2]}) / GRID, bottom = std::min({gy[0], gy[1], gy[2]}) / GRID;
        const int64_t right = (std::max({gx[0], gx[1], gx[2]}) - 1) / GRID + 1;
        const int64_t top = (std::max({gy[0], gy[1], gy[2]}) - 1) / GRID + 1;
        const int64_t box[4] = {
            std::max(left / SIDE, columns[0]), std::min((right + SIDE - 1) / SIDE, columns[1]),
            std::max(bottom / SIDE, rows[0]), std::min((top + SIDE - 1) / SIDE, rows[1])};
        std::optional<Plane<float>> z;  // most small faces cover no sample
        std::optional<Surface> surface;  // where its texture decides what it takes
        auto take = [&](Ints inside, int32_t row, int32_t column) {
            if (!bits_of(inside)) return;
            if (!z) z.emplace(Slopes(of, t), of.z[t[0]], of.z[t[1]], of.z[t[2]]);
            const Floats px = x + float(SIDE * column), py = y + float(SIDE * row);
            const Floats depths = fuse(z->along_y, py, fuse(z->along_x, px, Floats{} + z->start));
            if (piece.holes && !surface) surface.emplace(of, t);
            this->take(piece, surface, Taken{face, row, column, 0, {}}, inside, depths);
        };
        if (right - left <= SMALL && top - bottom <= SMALL)
            cover<int32_t>(gx, gy, box, grid_x, grid_y, take);
        else
            cover<int64_t>(gx, gy, box, __builtin_convertvector(grid_x, Longs), __builtin_convertvector(grid_y, Longs),
                           take);
        return true;
    }

    template <class I, class Vector, class Visit>
    void cover(const int32_t *gx, const int32_t *gy, const int64_t *box, const Vector &sx, const Vector &sy,
               Visit visit) {
        Edges<I, Vector> edges(gx, gy, box, sx, sy);
        for (int32_t row = box[2]; row < box[3]; ++row) {
            I e[3] = {edges.start[0], edges.start[1], edges.start[2]};
            for (int32_t column = box[0]; column < box[1]; ++column) {
                if ((e[0] + edges.most[0] > 0) & (e[1] + edges.most[1] > 0) & (e[2] + edges.most[2] > 0)) {
                    const auto inside = (edges.at[0] + e[0] > 0) & (edges.at[1] + e[1] > 0) & (edges.at[2] + e[2] > 0);
                    visit(__builtin_convertvector(inside, Ints), row, column);
                }
                for (int i = 0; i < 3; ++i) e[i] += edges.right[i];
            }
            for (int i = 0; i < 3; ++i) edges.start[i] += edges.up[i];
        }
    }

    void take(const Piece &piece, const std::optional<Surface> &surface, Taken it, Ints inside, Floats z) {
        const int64_t here = block(it.row, it.column);
        const Floats known = depth[here];
        inside &= z < known;
        it.samples = bits_of(inside);
        if (!it.samples) return;
        for (int p = 0; p < PIXELS; ++p) {
            const unsigned mine = it.samples >> SAMPLES * p & 15;
            it.places[p] = mine == 0 || mine == 15 ? MIDDLE : __builtin_ctz(mine);
        }
        if (piece.holes) {  // pixels that look through one are let go
            for (int p = 0; p < PIXELS; ++p)
                if (it.samples >> SAMPLES * p & 15 && texel(piece.texture, *surface, it, p).c[3] < 0.5f) {
                    it.samples &= ~(15u << SAMPLES * p);
                    for (int s = 0; s < SAMPLES; ++s) inside[SAMPLES * p + s] = 0;
                }
            if (!it.samples) return;
        }
        if (piece.blended) {
            layers.push_back(it);
            return;
        }
        depth[here] = choose(inside, z, known);
        top[here] = (inside & (int32_t)taken.size()) | (~inside & top[here]);
        taken.push_back(it);
    }
};

}  // namespace
