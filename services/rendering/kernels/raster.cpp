#pragma GCC optimize("fp-contract=off")
// Pictures as llvmpipe draws them, bit for bit, without what it spends on every small triangle (services/rendering/
// raster.py): faces first (coverage.h), then only what shows of them is shaded (radiance.h), once for all pictures.

#include <atomic>
#include <thread>

#include "coverage.h"
#include "radiance.h"

namespace {

struct Owner {
    int32_t piece, corners[3];
};

// A face in a pixel.
struct Fragment {
    const Taken *of;
    int32_t pixel;
};

// What fragments are shaded by, one a lane: where they are, how far to the next pixels, and their own.
struct Seen {
    Floats place[3], right[3], up[3], normal[3], texel[3], opacity;
    int32_t pieces[WIDTH];
};

inline Vector vector(const Floats *of) { return {of[0], of[1], of[2]}; }

struct Drawing {
    const Frame &frame;
    const Pass &pass;
    Picture picture;
    std::vector<Corners> corners;
    std::vector<Owner> owners;  // of the faces drawn
    std::vector<Fragment> fragments;
    std::vector<int32_t> shown;  // of each sample, its fragment
    std::vector<int32_t> laid;  // of each layer and pixel, its fragment
    std::vector<float> colors;  // [pictures, 3, fragments]
    std::vector<Surface> surfaces;  // of the faces that show
    std::vector<int32_t> number;  // of each face, among them
    int64_t padded = 0;

    Drawing(const Frame &frame, const Pass &pass) : frame(frame), pass(pass), picture(frame, pass.part) {}

    // False if the driver would have cut faces.
    bool cover() {
        for (int64_t i = 0; i < frame.pieces; ++i) {
            corners.emplace_back(frame.piece[i], pass.clip + 16 * i, pass.world + 16 * i, pass.normal + 9 * i, frame);
            if (!corners.back().whole) return false;
        }
        for (int64_t k = 0; k < frame.pieces; ++k) {
            const int64_t i = pass.order[k];
            const Piece &piece = frame.piece[i];
            for (int64_t f = 0; f < piece.faces; ++f) {
                const int32_t *t = piece.triangles + 3 * f;
                Owner owner{int32_t(i), {t[0], t[1], t[2]}};
                if (picture.draw(piece, corners[i], owner.corners, f < pass.closed[i], owners.size()))
                    owners.push_back(owner);
            }
        }
        return true;
    }

    // Each face in a pixel once, whatever samples of it show.
    void collect() {
        shown.assign(picture.top.size() * WIDTH, NONE);
        for (size_t block = 0; block < picture.top.size(); ++block) {
            const Ints top = picture.top[block];
            for (int i = 0; i < WIDTH; ++i) {
                if (top[i] == NONE) continue;
                int32_t &mine = shown[block * WIDTH + i];
                for (int k = i & -SAMPLES; k < i; ++k)
                    if (top[k] == top[i]) mine = shown[block * WIDTH + k];
                if (mine == NONE) {
                    mine = fragments.size();
                    fragments.push_back({&picture.taken[top[i]], i / SAMPLES});
                }
            }
        }
        for (const Taken &layer : picture.layers)
            for (int p = 0; p < PIXELS; ++p) {
                laid.push_back(layer.samples >> SAMPLES * p & 15 ? int32_t(fragments.size()) : NONE);
                if (laid.back() != NONE) fragments.push_back({&layer, p});
            }
    }

    const Surface &surface_of(const Taken &of) {
        int32_t &mine = number[of.face];
        if (mine == NONE) {
            mine = surfaces.size();
            surfaces.emplace_back(corners[owners[of.face].piece], owners[of.face].corners);
        }
        return surfaces[mine];
    }

    void see(const Fragment &fragment, int i, Seen &seen) {
        const Taken &of = *fragment.of;
        const Surface &surface = surface_of(of);
        const int32_t px = SIDE * of.column + fragment.pixel % SIDE, py = SIDE * of.row + fragment.pixel / SIDE;
        // World positions in the middles of the pixel and of its neighbours in the block.
        auto middle = [&](int32_t x, int32_t y, float *out) {
            const float w = 1.0f / surface.w.at(x + 0.5f, y + 0.5f);
            const Channels values = surface.channels.at(x + 0.5f, y + 0.5f);
            for (int k = 0; k < 3; ++k) out[k] = values[k] * w;
            return w;
        };
        float here[3], beside[3], above[3];
        const float w = middle(px, py, here);
        middle(px ^ 1, py, beside), middle(px, py ^ 1, above);
        const int place = of.places[fragment.pixel];
        const Channels there = surface.channels.at(px + picture.place_x[place], py + picture.place_y[place]);
        const float to_right = px & 1 ? -1 : 1, to_top = py & 1 ? -1 : 1;
        for (int k = 0; k < 3; ++k) {
            seen.place[k][i] = here[k];
            seen.right[k][i] = to_right * (beside[k] - here[k]), seen.up[k][i] = to_top * (above[k] - here[k]);
            seen.normal[k][i] = there[3 + k] * w;
        }
        seen.pieces[i] = owners[of.face].piece;
        const Piece &piece = frame.piece[seen.pieces[i]];
        seen.opacity[i] = float(piece.opacity);
        Texel texel{1, 1, 1, 1};
        if (piece.texture.levels) texel = picture.texel(piece.texture, surface, of, fragment.pixel);
        for (int c = 0; c < 3; ++c) seen.texel[c][i] = texel.c[c];
    }

    float color(int64_t k, int c, int32_t fragment) const { return colors[(3 * k + c) * padded + fragment]; }

    void shade() {
        const int64_t count = fragments.size();
        padded = (count + WIDTH - 1) / WIDTH * WIDTH;
        colors.resize(pass.pictures * 3 * padded);
        number.assign(owners.size(), NONE);
        for (int64_t first = 0; first < count; first += WIDTH) {
            Seen seen;
            for (int i = 0; i < WIDTH; ++i) see(fragments[std::min(first + i, count - 1)], i, seen);
            const Vector place = vector(seen.place);
            const Vector v = unit(all(frame.eye) - place);
            const Vector n = surface_normal(vector(seen.normal), vector(seen.right), vector(seen.up), v);
            const Floats facing = dot(n, v);
            for (int64_t k = 0; k < pass.pictures; ++k) {
                const Light light{pass.ambients[k], pass.points + 4 * pass.lights * k, pass.lights};
                const Shade sum = radiance(light, place, v, n, facing);
                for (int c = 0; c < 3; ++c) {
                    float *out = &colors[(3 * k + c) * padded + first];
                    const float *base = pass.colors + 3 * frame.pieces * k + c;
                    for (int i = 0; i < WIDTH; ++i) {
                        const float opaque = base[3 * seen.pieces[i]] * seen.texel[c][i] * seen.opacity[i];
                        out[i] = opaque * sum.body[i] + sum.gloss[i];
                    }
                }
            }
        }
    }

    // The samples of a block in a picture: red, green, blue, opacity; nothing where no face is.
    void show(int64_t block, int64_t k, float (*samples)[4]) const {
        for (int i = 0; i < WIDTH; ++i) {
            const int32_t fragment = shown[block * WIDTH + i];
            for (int c = 0; c < 3; ++c) samples[i][c] = fragment == NONE ? 0 : color(k, c, fragment);
            samples[i][3] = fragment == NONE ? 0 : 1;
        }
    }

    // And what a layer lets through of them.
    void lay_over(int64_t layer, int64_t k, float (*samples)[4]) const {
        const Taken &of = picture.layers[layer];
        const float opacity = frame.piece[owners[of.face].piece].opacity, through = 1.0f - opacity;
        for (int i = 0; i < WIDTH; ++i) {
            if (!(of.samples >> i & 1)) continue;
            const int32_t fragment = laid[layer * PIXELS + i / SAMPLES];
            for (int c = 0; c < 3; ++c) samples[i][c] = color(k, c, fragment) + samples[i][c] * through;
            samples[i][3] = opacity + samples[i][3] * through;
        }
    }

    void average() const {
        // The first layer of each block, and the one after each.
        std::vector<int32_t> first(picture.top.size(), NONE), next(picture.layers.size());
        for (int64_t l = int64_t(next.size()) - 1; l >= 0; --l) {
            int32_t &mine = first[picture.block(picture.layers[l].row, picture.layers[l].column)];
            next[l] = mine, mine = l;
        }
        const int64_t *part = pass.part, wide = part[3] - part[2];
        for (int64_t k = 0; k < pass.pictures; ++k)
            for (int64_t row = picture.rows[0]; row < picture.rows[1]; ++row)
                for (int64_t column = picture.columns[0]; column < picture.columns[1]; ++column) {
                    const int64_t block = picture.block(row, column);
                    float samples[WIDTH][4];
                    show(block, k, samples);
                    for (int32_t l = first[block]; l != NONE; l = next[l]) lay_over(l, k, samples);
                    for (int p = 0; p < PIXELS; ++p) {
                        const int64_t y = SIDE * row + p / SIDE, x = SIDE * column + p % SIDE;
                        if (y < part[0] || y >= part[1] || x < part[2] || x >= part[3]) continue;
                        float *out = pass.images + ((k * (part[1] - part[0]) + y - part[0]) * wide + x - part[2]) * 4;
                        for (int c = 0; c < 4; ++c) {
                            float sum = 0;
                            for (int s = 0; s < SAMPLES; ++s) sum += samples[SAMPLES * p + s][c];
                            out[c] = sum * (1.0f / SAMPLES);
                        }
                    }
                }
    }
};

}  // namespace

EXPORT void raster_float(const Frame *frame, int64_t passes, Pass *pass, int threads) {
    std::atomic<int64_t> next{0};
    auto work = [&] {
        for (int64_t p; (p = next++) < passes;) {
            Drawing drawing(*frame, pass[p]);
            pass[p].drawn = drawing.cover();
            if (!pass[p].drawn) continue;
            drawing.collect();
            drawing.shade();
            drawing.average();
            pass[p].shown = drawing.surfaces.size();
        }
    };
    // Threads of their own, which end: those of OpenMP wait for more work on the cores that are used now.
    std::vector<std::thread> others;
    for (int64_t k = 1; k < std::min<int64_t>(threads, passes); ++k) others.emplace_back(work);
    work();
    for (std::thread &other : others) other.join();
}

STRUCTURE(Texture, Texture, FIELD(Texture, levels) FIELD(Texture, texels) FIELD(Texture, sizes))
STRUCTURE(Piece, Piece,
          FIELD(Piece, corners) FIELD(Piece, faces) FIELD(Piece, positions) FIELD(Piece, normals) FIELD(Piece, uv)
          FIELD(Piece, triangles) FIELD(Piece, holes) FIELD(Piece, blended) FIELD(Piece, opacity) FIELD(Piece, texture))
STRUCTURE(Frame, Frame,
          FIELD(Frame, width) FIELD(Frame, height) FIELD(Frame, pieces) FIELD(Frame, piece) FIELD(Frame, x)
          FIELD(Frame, y) FIELD(Frame, eye))
STRUCTURE(Pass, Pass,
          FIELD(Pass, clip) FIELD(Pass, world) FIELD(Pass, normal) FIELD(Pass, order) FIELD(Pass, closed)
          FIELD(Pass, part) FIELD(Pass, pictures) FIELD(Pass, lights) FIELD(Pass, ambients) FIELD(Pass, points)
          FIELD(Pass, colors) FIELD(Pass, images) FIELD(Pass, drawn) FIELD(Pass, shown))
FUNCTION(raster_float)
