// Which samples of an image each face of a scene covers: the first half of the rasteriser, whose rules are these.
//
// - Coordinates are counted in pixels from the image's lower left corner. A pixel has four samples, at the places that
//   `Frame` gives. Corners are float32; for coverage alone they are rounded to 1/256 of a pixel.
// - A face covers the samples inside of its three edges, exactly, in integers. A sample on an edge belongs to the face
//   to the right of a left edge or above a bottom edge, so that one of two faces with a common edge has it.
// - Depth is linear over the image. An opaque face has the samples at which it is nearest, the first drawn of equals.
// - A face is shaded once per pixel. Its normal is that in the pixel's centre if it is nearest at all four samples (or
//   none) when it is drawn, else at the first at which it is. Its position, perspective and texture are the centre's.
// - A texture's coordinates change from pixel to pixel as between the centres of the first three of a block of 2 x 2.

#pragma once

#include "texture.h"

namespace {

constexpr int SAMPLES = 4, SIDE = 2, PIXELS = SIDE * SIDE;  // samples of a pixel; sides and pixels of a block
static_assert(WIDTH == SAMPLES * PIXELS, "a vector is a block's samples");
constexpr int GRID = 256, BLOCK = GRID * SIDE;  // steps of a pixel, of a block
constexpr int MAX_EXTENT = 4096;  // pixels between corners at most, so that edges within a block fit 32 bits
constexpr int32_t NONE = -1;

struct Piece {
    int64_t corners, faces;
    const float *positions, *normals, *uv;  // [corners, 3], [corners, 3], [corners, 2]
    const int32_t *triangles;  // [faces, 3]
    int64_t holes;
    double opacity;
    double metallic, roughness;  // in [0,1]; metallic is -1 for a Lambertian body under a coat
    Texture texture;
};

struct Frame {
    int64_t width, height, pieces;
    const Piece *piece;
    float x[SAMPLES], y[SAMPLES];  // where in a pixel its samples are, from the lower left
};

struct Pass {
    float eye[3];  // the camera's position
    const float *clip, *world, *normal;  // [pieces, 16], [pieces, 16], [pieces, 9], from the object
    const int64_t *order, *n_watertight_faces;  // [pieces], as drawn; backfaces of so many first faces are culled
    int64_t part[4];  // rows from the bottom from, to, columns from, to
    int64_t n_images, lights;
    const float *ambients, *points, *colors;  // [images], [images, lights, 4]: intensity, place; [images, pieces, 3]
    float *images;  // [images, rows, columns, 4], added to
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

    // Twice the area of a face on the grid, positive where its corners are counter-clockwise.
    int64_t area(const int32_t *t) const {
        const int64_t x0 = grid_x[t[0]], y0 = grid_y[t[0]];
        return (grid_x[t[1]] - x0) * (grid_y[t[2]] - y0) - (grid_x[t[2]] - x0) * (grid_y[t[1]] - y0);
    }
};

// A quantity that is linear over the image, by its values in a face's corners.
template <class T> struct Linear {
    float x, y;
    T start, right, up;

    Linear() = default;
    Linear(const Corners &of, const int32_t *t, T a, T b, T c) : x(of.x[t[0]]), y(of.y[t[0]]), start(a) {
        const float bx = of.x[t[1]] - x, by = of.y[t[1]] - y, cx = of.x[t[2]] - x, cy = of.y[t[2]] - y;
        const float scale = 1 / (bx * cy - by * cx);
        right = (b - a) * (cy * scale) - (c - a) * (by * scale), up = (c - a) * (bx * scale) - (b - a) * (cx * scale);
    }
    template <class P> auto at(P px, P py) const { return start + (px - x) * right + (py - y) * up; }
};

// A bit for each lane of a mask.
inline uint32_t bits_of(Ints mask) {
    uint32_t bits = 0;
    for (int i = 0; i < WIDTH; ++i) bits |= (mask[i] & 1) << i;
    return bits;
}

// A face in a block.
struct Fragment {
    int32_t face, block;
    uint32_t nearest, solid;  // bits of the block's samples at which the face is nearest when drawn; and is no hole
};

// The side of an edge of a face: a function of the place, positive inside, exact in integers.
struct Edge {
    Ints at_samples;  // in a block, less the value in the block's lower left corner
    int64_t right, up, start;

    Edge(int64_t x, int64_t y, int64_t next_x, int64_t next_y, Ints sample_x, Ints sample_y)
        : right(y - next_y), up(next_x - x), start((right > 0 || (right == 0 && up > 0)) - right * x - up * y) {
        at_samples = int32_t(right) * sample_x + int32_t(up) * sample_y;
    }
    int64_t corner(int64_t row, int64_t column) const { return start + BLOCK * (right * column + up * row); }
    bool misses(int64_t row, int64_t column) const {
        return corner(row, column) + BLOCK * (std::max<int64_t>(right, 0) + std::max<int64_t>(up, 0)) <= 0;
    }
    Ints inside(int64_t row, int64_t column) const {  // where it does not miss the block
        return at_samples + (int32_t)std::min<int64_t>(corner(row, column), 1 << 30) > 0;
    }
};

// What is seen at each sample of a part of an image, which is cut into blocks.
struct Visibility {
    const int64_t *part;
    int64_t rows[2], columns[2];  // of blocks, from, to
    Floats x, y;  // of a block's samples, in it, in pixels
    Ints grid_x, grid_y;
    std::vector<Floats> depth;  // of the nearest opaque face
    std::vector<Ints> top;  // its fragment, or NONE
    std::vector<Fragment> fragments;  // in the order they are drawn

    Visibility(const Frame &frame, const int64_t *part)
        : part(part), rows{part[0] / SIDE, (part[1] + SIDE - 1) / SIDE},
          columns{part[2] / SIDE, (part[3] + SIDE - 1) / SIDE},
          depth((rows[1] - rows[0]) * (columns[1] - columns[0]), Floats{} + 1.0f), top(depth.size(), Ints{} + NONE) {
        for (int i = 0; i < WIDTH; ++i) {
            x[i] = i / SAMPLES % SIDE + frame.x[i % SAMPLES], y[i] = i / SAMPLES / SIDE + frame.y[i % SAMPLES];
            grid_x[i] = (int32_t)std::lround(GRID * x[i]), grid_y[i] = (int32_t)std::lround(GRID * y[i]);
        }
    }

    // A pixel of a block: its column and row.
    std::pair<int32_t, int32_t> pixel(int32_t block, int number) const {
        const int64_t wide = columns[1] - columns[0];
        return {SIDE * (columns[0] + block % wide) + number % SIDE, SIDE * (rows[0] + block / wide) + number / SIDE};
    }

    // Where a face's normal is looked up in a pixel of a fragment's block.
    std::pair<float, float> place(const Fragment &f, int number) const {
        const auto [left, bottom] = pixel(f.block, number);
        const uint32_t samples = f.nearest >> SAMPLES * number & 15;
        if (samples == 0 || samples == 15) return {left + 0.5f, bottom + 0.5f};
        return {left + x[__builtin_ctz(samples)], bottom + y[__builtin_ctz(samples)]};
    }

    // The blocks from and to which a face reaches, by the grid's coordinate of its corners, within the part's.
    static std::pair<int64_t, int64_t> blocks(const std::vector<int32_t> &grid, const int32_t *t, const int64_t *part) {
        const auto [low, high] = std::minmax({grid[t[0]], grid[t[1]], grid[t[2]]});
        return {std::max<int64_t>(low / BLOCK, part[0]), std::min<int64_t>(high / BLOCK + 1, part[1])};
    }

    // Draws a face of corners `t`, which are counter-clockwise. `solid`: the samples of a fragment that are in no hole.
    template <class Solid> void draw(const Corners &of, const int32_t *t, int32_t face, bool blended, Solid solid) {
        const auto [left, right] = blocks(of.grid_x, t, columns);
        const auto [bottom, above] = blocks(of.grid_y, t, rows);
        const auto edge = [&](int32_t a, int32_t b) {
            return Edge(of.grid_x[a], of.grid_y[a], of.grid_x[b], of.grid_y[b], grid_x, grid_y);
        };
        const Edge edges[3] = {edge(t[0], t[1]), edge(t[1], t[2]), edge(t[2], t[0])};
        const Linear<float> plane(of, t, of.z[t[0]], of.z[t[1]], of.z[t[2]]);
        for (int64_t row = bottom; row < above; ++row)
            for (int64_t column = left; column < right; ++column) {
                if (std::any_of(edges, edges + 3, [&](const Edge &edge) { return edge.misses(row, column); })) continue;
                const int32_t block = (row - rows[0]) * (columns[1] - columns[0]) + column - columns[0];
                const Floats z = plane.at(x + float(SIDE * column), y + float(SIDE * row));
                Ints nearest = z < depth[block];
                for (const Edge &edge : edges) nearest &= edge.inside(row, column);
                if (const uint32_t samples = bits_of(nearest)) {
                    nearest &= solid(Fragment{face, block, samples, samples});
                    if (!blended) {
                        depth[block] = choose(nearest, z, depth[block]);
                        top[block] = (nearest & int32_t(fragments.size())) | (~nearest & top[block]);
                    }
                    fragments.push_back({face, block, samples, bits_of(nearest)});
                }
            }
    }
};

}  // namespace
