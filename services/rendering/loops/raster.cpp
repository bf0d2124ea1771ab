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
                if (picture.draw(piece, corners[i], owner.corners, f < pass.closed[i], owners.size())) owners.push_back(owner);
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

    void shade() {
        const int64_t count = fragments.size();
        padded = (count + WIDTH - 1) / WIDTH * WIDTH;
        colors.resize(pass.pictures * 3 * padded);
        std::vector<int32_t> number(owners.size(), NONE);
        for (int64_t first = 0; first < count; first += WIDTH) {
            Vector place, right, up, normal;
            Floats texel[3] = {Floats{} + 1.0f, Floats{} + 1.0f, Floats{} + 1.0f}, opacity;
            int32_t pieces[WIDTH];
            for (int i = 0; i < WIDTH; ++i) {
                const Fragment &fragment = fragments[std::min(first + i, count - 1)];
                const Taken &of = *fragment.of;
                const Owner &owner = owners[of.face];
                if (number[of.face] == NONE) {
                    number[of.face] = surfaces.size();
                    surfaces.emplace_back(corners[owner.piece], owner.corners);
                }
                const Surface &surface = surfaces[number[of.face]];
                const int32_t px = SIDE * of.column + fragment.pixel % SIDE, py = SIDE * of.row + fragment.pixel / SIDE;
                auto at = [&](int32_t x, int32_t y, Channels &values, float &w) {
                    w = 1.0f / surface.w.at(x + 0.5f, y + 0.5f);
                    values = surface.channels.at(x + 0.5f, y + 0.5f);
                };
                Channels here, beside, above, there;
                float w, w_beside, w_above;
                at(px, py, here, w), at(px ^ 1, py, beside, w_beside), at(px, py ^ 1, above, w_above);
                const int at_sample = of.places[fragment.pixel];
                there = surface.channels.at(px + picture.place_x[at_sample], py + picture.place_y[at_sample]);
                const float turn_x = px & 1 ? -1 : 1, turn_y = py & 1 ? -1 : 1;
                place.x[i] = here[0] * w, place.y[i] = here[1] * w, place.z[i] = here[2] * w;
                right.x[i] = turn_x * (beside[0] * w_beside - place.x[i]);
                right.y[i] = turn_x * (beside[1] * w_beside - place.y[i]);
                right.z[i] = turn_x * (beside[2] * w_beside - place.z[i]);
                up.x[i] = turn_y * (above[0] * w_above - place.x[i]);
                up.y[i] = turn_y * (above[1] * w_above - place.y[i]);
                up.z[i] = turn_y * (above[2] * w_above - place.z[i]);
                normal.x[i] = there[3] * w, normal.y[i] = there[4] * w, normal.z[i] = there[5] * w;
                const Piece &piece = frame.piece[owner.piece];
                pieces[i] = owner.piece, opacity[i] = float(piece.opacity);
                if (piece.texture.levels) {
                    const Texel found = picture.texel(piece.texture, surface, of, fragment.pixel);
                    for (int c = 0; c < 3; ++c) texel[c][i] = found.c[c];
                }
            }
            const Vector v = unit(all(frame.eye) - place), n = surface_normal(normal, right, up, v);
            const Floats facing = dot(n, v);
            for (int64_t k = 0; k < pass.pictures; ++k) {
                const Shade sum = ::shade({pass.ambients[k], pass.points + 4 * pass.lights * k, pass.lights}, place, v, n, facing);
                for (int c = 0; c < 3; ++c) {
                    float *out = &colors[(3 * k + c) * padded + first];
                    const float *base = pass.colors + 3 * frame.pieces * k + c;
                    for (int i = 0; i < WIDTH; ++i)
                        out[i] = base[3 * pieces[i]] * texel[c][i] * opacity[i] * sum.body[i] + sum.gloss[i];
                }
            }
        }
    }

    // The samples of a block in a picture, nothing where no face is.
    void samples_of(int64_t block, int64_t k, float (*out)[4]) const {
        for (int i = 0; i < WIDTH; ++i) {
            const int32_t fragment = shown[block * WIDTH + i];
            for (int c = 0; c < 3; ++c) out[i][c] = fragment == NONE ? 0 : colors[(3 * k + c) * padded + fragment];
            out[i][3] = fragment == NONE ? 0 : 1;
        }
    }

    void average() const {
        typedef float Block[WIDTH][4];
        std::vector<int32_t> number(picture.top.size(), NONE);  // of the blocks with layers
        int32_t layered = 0;
        for (const Taken &layer : picture.layers) {
            int32_t &mine = number[picture.block(layer.row, layer.column)];
            if (mine == NONE) mine = layered++;
        }
        std::vector<float> over(layered * sizeof(Block) / sizeof(float));
        Block *blocks = reinterpret_cast<Block *>(over.data());
        for (int64_t k = 0; k < pass.pictures; ++k) {
            for (size_t block = 0; block < number.size(); ++block)
                if (number[block] != NONE) samples_of(block, k, blocks[number[block]]);
            for (size_t l = 0; l < picture.layers.size(); ++l) {
                const Taken &layer = picture.layers[l];
                Block &block = blocks[number[picture.block(layer.row, layer.column)]];
                const float opacity = frame.piece[owners[layer.face].piece].opacity, through = 1.0f - opacity;
                for (int i = 0; i < WIDTH; ++i) {
                    if (!(layer.samples >> i & 1)) continue;
                    const int32_t fragment = laid[l * PIXELS + i / SAMPLES];
                    for (int c = 0; c < 3; ++c)
                        block[i][c] = colors[(3 * k + c) * padded + fragment] + block[i][c] * through;
                    block[i][3] = opacity + block[i][3] * through;
                }
            }
            const int64_t high = pass.part[1] - pass.part[0], wide = pass.part[3] - pass.part[2];
            for (int64_t row = 0; row < high; ++row)
                for (int64_t column = 0; column < wide; ++column) {
                    const int64_t y = row + pass.part[0], x = column + pass.part[2], block = picture.block(y / SIDE, x / SIDE);
                    const int64_t first = (y % SIDE * SIDE + x % SIDE) * SAMPLES;
                    float *out = pass.images + ((k * high + row) * wide + column) * 4, sum[4] = {0, 0, 0, 0};
                    const int32_t *of = &shown[block * WIDTH + first];
                    if (number[block] != NONE) {
                        for (int s = 0; s < SAMPLES; ++s)
                            for (int c = 0; c < 4; ++c) sum[c] += blocks[number[block]][first + s][c];
                    } else {
                        for (int s = 0; s < SAMPLES; ++s) {
                            if (of[s] == NONE) continue;
                            for (int c = 0; c < 3; ++c) sum[c] += colors[(3 * k + c) * padded + of[s]];
                            sum[3] += 1;
                        }
                    }
                    for (int c = 0; c < 4; ++c) out[c] = sum[c] * (1.0f / SAMPLES);
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
