// Which samples of an image each face of a scene covers: the first half of the rasteriser, whose rules are these.
//
// - Coordinates are counted in pixels from the image's lower left corner. A pixel has four samples, at the places that
//   `Frame` gives. Corners are float32; for coverage alone they are rounded to 1/256 of a pixel.
// - A face covers the samples inside of its three edges, exactly, in integers. A sample on an edge belongs to the face
//   to the right of a left edge or above a bottom edge, so that one of two faces with a common edge has it.
// - Depth is linear over the image. An opaque face has the samples at which it is nearest, the first drawn of equals.
// - A face is shaded once per pixel: in the pixel's centre if it has all four samples (or none) when it is drawn, else at
//   the first sample it has. Normal and texture are looked up there; position and perspective are the centre's.

#pragma once

#include "texture.h"

namespace {

constexpr int SAMPLES = 4, SIDE = 2, PIXELS = SIDE * SIDE;  // samples of a pixel; sides and pixels of a block
static_assert(WIDTH == SAMPLES * PIXELS, "a vector is a block's samples");
constexpr int CENTRE = SAMPLES;  // the place in a pixel that is no sample
constexpr int GRID = 256, BLOCK = GRID * SIDE;  // steps of a pixel, of a block
constexpr int MAX_EXTENT = 4096;  // pixels between corners at most, so that edges within a block fit 32 bits
constexpr int32_t NONE = -1;

struct Piece {
    static std::string layout_name() { return "Piece"; }

    int64_t corners, faces;
    const float *positions, *normals, *uv;  // [corners, 3], [corners, 3], [corners, 2]
    const int32_t *triangles;  // [faces, 3]
    int64_t holes;
    double opacity;
    Texture texture;
};

struct Frame {
    static std::string layout_name() { return "Frame"; }

    int64_t width, height, pieces;
    const Piece *piece;
    float x[SAMPLES], y[SAMPLES];  // where in a pixel its samples are, from the lower left
    float eye[3];
};

struct Pass {
    static std::string layout_name() { return "Pass"; }

    const float *clip, *world, *normal;  // [pieces, 16], [pieces, 16], [pieces, 9], from the object
    const int64_t *order, *closed;  // [pieces], as drawn; of each piece's faces the first so many have no inside
    int64_t part[4];  // rows from the bottom from, to, columns from, to
    int64_t n_images, lights;
    const float *ambients, *points, *colors;  // [images], [images, lights, 4], [images, pieces, 3]
    float *images;  // [images, rows, columns, 4]
    int64_t shown;  // faces; -1: one reaches to the near plane or far beyond the frame, and nothing was drawn
};

// The corners of a piece: in pixels, on the grid, depth from 0 to 1, and 1 / w.
struct Corners {
    std::vector<float> x, y, z, w;
    std::vector<int32_t> grid_x, grid_y;
    bool drawable = true;

    Corners(const Piece &piece, const float *m, const Frame &frame)
        : x(piece.corners), y(x), z(x), w(x), grid_x(piece.corners), grid_y(grid_x) {
        const float half_width = frame.width / 2.0f, half_height = frame.height / 2.0f, reach = MAX_EXTENT / 2;
        int32_t beyond = 0;
#pragma omp simd reduction(| : beyond)
        for (int64_t i = 0; i < piece.corners; ++i) {
            const float *p = piece.positions + 3 * i;
            const float clip_z = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
            const float clip_w = m[12] * p[0] + m[13] * p[1] + m[14] * p[2] + m[15];
            w[i] = 1 / clip_w;
            x[i] = half_width * (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) * w[i];
            y[i] = half_height * (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) * w[i];
            beyond |= !((clip_w > 0) & (clip_z >= -clip_w) & (std::abs(x[i]) < reach) & (std::abs(y[i]) < reach));
            x[i] += half_width, y[i] += half_height, z[i] = 0.5f * clip_z * w[i] + 0.5f;
            grid_x[i] = (int32_t)std::nearbyint(x[i] * GRID), grid_y[i] = (int32_t)std::nearbyint(y[i] * GRID);
        }
        drawable = !beyond;
    }
};

// The weights of a face's second and third corner, linear over the image: 1 in that corner, 0 in the others.
struct Weights {
    float x, y, right[2], up[2];

    Weights(const Corners &of, const int32_t *t) : x(of.x[t[0]]), y(of.y[t[0]]) {
        const float bx = of.x[t[1]] - x, by = of.y[t[1]] - y, cx = of.x[t[2]] - x, cy = of.y[t[2]] - y;
        const float scale = 1 / (bx * cy - by * cx);
        right[0] = cy * scale, up[0] = -cx * scale, right[1] = -by * scale, up[1] = bx * scale;
    }
    template <class T> T at(int corner, T px, T py) const { return right[corner] * (px - x) + up[corner] * (py - y); }
};

// What a face has of a block of pixels.
struct Coverage {
    int32_t face, row, column;  // the block's
    uint32_t nearest = 0, samples = 0;  // a bit for each at which it is nearest; and of those the ones outside of holes

    int place(int pixel) const {
        const uint32_t mine = nearest >> SAMPLES * pixel & 15;
        return mine == 0 || mine == 15 ? CENTRE : __builtin_ctz(mine);
    }
    int32_t x(int pixel) const { return SIDE * column + pixel % SIDE; }
    int32_t y(int pixel) const { return SIDE * row + pixel / SIDE; }
};

// A bit for each lane of a mask.
inline uint32_t bits_of(Ints mask) {
    uint32_t bits = 0;
    for (int i = 0; i < WIDTH; ++i) bits |= (mask[i] & 1) << i;
    return bits;
}

// A part of an image: rows from, to, columns from, to, in blocks; and what is seen at each of its samples.
struct Visibility {
    int64_t rows[2], columns[2];
    Floats x, y;  // of a block's samples, in it
    Ints grid_x, grid_y;
    float place_x[SAMPLES + 1], place_y[SAMPLES + 1];  // in a pixel
    std::vector<Floats> depth;
    std::vector<Ints> top;  // the one of `opaque` that is seen, or NONE
    std::vector<Coverage> opaque, layers;  // in the order they are drawn

    Visibility(const Frame &frame, const int64_t *part)
        : rows{part[0] / SIDE, (part[1] + SIDE - 1) / SIDE}, columns{part[2] / SIDE, (part[3] + SIDE - 1) / SIDE},
          depth((rows[1] - rows[0]) * (columns[1] - columns[0]), Floats{} + 1.0f), top(depth.size(), Ints{} + NONE) {
        for (int s = 0; s < SAMPLES; ++s) place_x[s] = frame.x[s], place_y[s] = frame.y[s];
        place_x[CENTRE] = place_y[CENTRE] = 0.5f;
        for (int i = 0; i < WIDTH; ++i) {
            x[i] = i / SAMPLES % SIDE + place_x[i % SAMPLES], y[i] = i / SAMPLES / SIDE + place_y[i % SAMPLES];
            grid_x[i] = (int32_t)std::lround(GRID * x[i]), grid_y[i] = (int32_t)std::lround(GRID * y[i]);
        }
    }

    int64_t block(const Coverage &of) const {
        return (of.row - rows[0]) * (columns[1] - columns[0]) + of.column - columns[0];
    }

    // A face of corners `t`, which it puts in counter-clockwise order. False if it has no area, or is seen from inside
    // and has no inside. `is_hole` is asked of pixels that the face covers.
    template <class Hole>
    bool draw(const Corners &of, int32_t *t, bool closed, int32_t face, bool blended, Hole is_hole) {
        const float area = (of.x[t[1]] - of.x[t[0]]) * (of.y[t[2]] - of.y[t[0]]) -
                           (of.x[t[2]] - of.x[t[0]]) * (of.y[t[1]] - of.y[t[0]]);
        if (area == 0 || (area < 0 && closed)) return false;
        if (area < 0) std::swap(t[1], t[2]);
        const int32_t gx[3] = {of.grid_x[t[0]], of.grid_x[t[1]], of.grid_x[t[2]]};
        const int32_t gy[3] = {of.grid_y[t[0]], of.grid_y[t[1]], of.grid_y[t[2]]};
        const int64_t left = std::max<int64_t>(std::min({gx[0], gx[1], gx[2]}) / BLOCK, columns[0]);
        const int64_t right = std::min<int64_t>(std::max({gx[0], gx[1], gx[2]}) / BLOCK + 1, columns[1]);
        const int64_t bottom = std::max<int64_t>(std::min({gy[0], gy[1], gy[2]}) / BLOCK, rows[0]);
        const int64_t top = std::min<int64_t>(std::max({gy[0], gy[1], gy[2]}) / BLOCK + 1, rows[1]);
        // Functions of the place, positive inside: in a block's corner, and what is added at samples and towards others.
        Ints samples[3];
        int64_t start[3], to_right[3], to_top[3], most[3];
        for (int i = 0, j = 1; i < 3; ++i, j = (j + 1) % 3) {
            const int32_t ex = gy[i] - gy[j], ey = gx[j] - gx[i];
            samples[i] = ex * grid_x + ey * grid_y;
            start[i] = ex * (BLOCK * left - gx[i]) + ey * (BLOCK * bottom - gy[i]) + (ex > 0 || (ex == 0 && ey > 0));
            to_right[i] = int64_t(ex) * BLOCK, to_top[i] = int64_t(ey) * BLOCK;
            most[i] = std::max<int64_t>(to_right[i], 0) + std::max<int64_t>(to_top[i], 0);
        }
        for (int64_t row = bottom; row < top; ++row) {
            int64_t e[3] = {start[0], start[1], start[2]};
            for (int64_t column = left; column < right; ++column) {
                if ((e[0] + most[0] > 0) & (e[1] + most[1] > 0) & (e[2] + most[2] > 0)) {
                    Ints inside = Ints{} - 1;
                    for (int i = 0; i < 3; ++i) inside &= samples[i] + (int32_t)std::min<int64_t>(e[i], 1 << 30) > 0;
                    if (bits_of(inside))
                        take(of, t, {face, int32_t(row), int32_t(column)}, inside, blended, is_hole);
                }
                for (int i = 0; i < 3; ++i) e[i] += to_right[i];
            }
            for (int i = 0; i < 3; ++i) start[i] += to_top[i];
        }
        return true;
    }

    // The samples that a face is inside of: those at which it is nearest and has no hole.
    template <class Hole>
    void take(const Corners &of, const int32_t *t, Coverage it, Ints inside, bool blended, Hole is_hole) {
        const Weights weights(of, t);
        const Floats px = x + float(SIDE * it.column), py = y + float(SIDE * it.row);
        const Floats z = of.z[t[0]] + weights.at(0, px, py) * (of.z[t[1]] - of.z[t[0]]) +
                         weights.at(1, px, py) * (of.z[t[2]] - of.z[t[0]]);
        const int64_t here = block(it);
        inside &= z < depth[here];
        it.nearest = it.samples = bits_of(inside);
        for (int p = 0; p < PIXELS; ++p)
            if (it.nearest >> SAMPLES * p & 15 && is_hole(it, p)) it.samples &= ~(15u << SAMPLES * p);
        if (!it.samples) return;
        if (blended) {
            layers.push_back(it);
            return;
        }
        for (int i = 0; i < WIDTH; ++i) inside[i] = -int32_t(it.samples >> i & 1);
        depth[here] = choose(inside, z, depth[here]);
        top[here] = (inside & (int32_t)opaque.size()) | (~inside & top[here]);
        opaque.push_back(it);
    }
};

}  // namespace
