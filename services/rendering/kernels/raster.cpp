// Images of a scene: which faces are seen first (coverage.h), then only these are shaded (radiance.h), each pixel of
// each once for all images of a pass.

#include <atomic>
#include <thread>

#include "coverage.h"
#include "radiance.h"

namespace {

// Position, normal and texture coordinates.
typedef float Attributes __attribute__((vector_size(8 * sizeof(float))));
enum { POSITION = 0, NORMAL = 3, UV = 6 };

// What a face is shaded by, at any place of the image.
struct Surface {
    Weights weights;
    float w[3], flat[3];  // 1 / w of the corners; a normal of the plane, on the viewer's side
    Attributes corners[3];

    Surface(const Piece &piece, const Corners &of, const int32_t *t, const float *world, const float *turn)
        : weights(of, t) {
        for (int i = 0; i < 3; ++i) {
            const float *p = piece.positions + 3 * t[i], *n = piece.normals + 3 * t[i];
            w[i] = of.w[t[i]];
            for (int k = 0; k < 3; ++k) {
                const float *a = world + 4 * k, *b = turn + 3 * k;
                corners[i][POSITION + k] = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + a[3];
                corners[i][NORMAL + k] = b[0] * n[0] + b[1] * n[1] + b[2] * n[2];
            }
            for (int k = 0; k < 2; ++k) corners[i][UV + k] = piece.uv ? piece.uv[2 * t[i] + k] : 0;
        }
        const Attributes b = corners[1] - corners[0], c = corners[2] - corners[0];
        for (int k = 0; k < 3; ++k) flat[k] = b[(k + 1) % 3] * c[(k + 2) % 3] - b[(k + 2) % 3] * c[(k + 1) % 3];
    }

    // 1 / w, and the attributes times that: linear in the image.
    float inverse(float x, float y) const {
        return w[0] + weights.at(0, x, y) * (w[1] - w[0]) + weights.at(1, x, y) * (w[2] - w[0]);
    }
    Attributes over_w(float x, float y) const {
        const float b = weights.at(0, x, y), c = weights.at(1, x, y);
        return (1 - b - c) * w[0] * corners[0] + b * w[1] * corners[1] + c * w[2] * corners[2];
    }
};

struct Face {
    int32_t piece, corners[3];
};

// A face in a pixel, and its share of the pixel's light.
struct Fragment {
    Coverage of;
    int32_t pixel;
    float weight;
};

// What WIDTH fragments are shaded by, one a lane.
struct FragmentInputs {
    Floats position[3], normal[3], flat[3], texel[3];
};

struct Drawing {
    const Frame &frame;
    const Pass &pass;
    Visibility seen;
    std::vector<Corners> corners;
    std::vector<Face> faces;  // those drawn
    std::vector<Fragment> fragments;
    std::vector<Surface> surfaces;  // of the faces that show
    std::vector<int32_t> surface_of;  // [faces]

    Drawing(const Frame &frame, const Pass &pass) : frame(frame), pass(pass), seen(frame, pass.part) {}

    Surface surface(const Face &face) const {
        const int64_t i = face.piece;
        return {frame.piece[i], corners[i], face.corners, pass.world + 16 * i, pass.normal + 9 * i};
    }

    // The attributes of a face at a place in a pixel.
    Attributes at(const Surface &surface, const Coverage &of, int pixel, int place) const {
        const int32_t x = of.x(pixel), y = of.y(pixel);
        return surface.over_w(x + seen.place_x[place], y + seen.place_y[place]) / surface.inverse(x + 0.5f, y + 0.5f);
    }

    // The texture of a face in a pixel; its changes from pixel to pixel are those of the block's first.
    Texel texel(const Texture &texture, const Surface &surface, const Coverage &of, int pixel) const {
        if (!texture.levels) return {1, 1, 1, 1};
        float u[PIXELS], v[PIXELS];
        for (int p = 0; p < PIXELS; ++p) {
            const Attributes there = at(surface, of, p, of.place(p));
            u[p] = there[UV], v[p] = there[UV + 1];
        }
        return sample(texture, u[pixel], v[pixel], u[1] - u[0], v[1] - v[0], u[SIDE] - u[0], v[SIDE] - v[0]);
    }

    // False if a face reaches to the near plane or far beyond the frame.
    bool cover() {
        for (int64_t i = 0; i < frame.pieces; ++i) {
            corners.emplace_back(frame.piece[i], pass.clip + 16 * i, frame);
            if (!corners.back().drawable) return false;
        }
        for (int64_t k = 0; k < frame.pieces; ++k) {
            const int64_t i = pass.order[k];
            const Piece &piece = frame.piece[i];
            for (int64_t f = 0; f < piece.faces; ++f) {
                const int32_t *t = piece.triangles + 3 * f;
                Face face{int32_t(i), {t[0], t[1], t[2]}};
                auto is_hole = [&](const Coverage &of, int pixel) {
                    return piece.holes && texel(piece.texture, surface(face), of, pixel).c[3] < 0.5f;
                };
                if (seen.draw(corners[i], face.corners, f < pass.closed[i], faces.size(), piece.opacity < 1, is_hole))
                    faces.push_back(face);
            }
        }
        return true;
    }

    void add(const Coverage &of, int pixel, float weight) {
        const int32_t x = of.x(pixel), y = of.y(pixel);
        if (y < pass.part[0] || y >= pass.part[1] || x < pass.part[2] || x >= pass.part[3]) return;
        if (surface_of[of.face] == NONE) {
            surface_of[of.face] = surfaces.size();
            surfaces.push_back(surface(faces[of.face]));
        }
        fragments.push_back({of, pixel, weight});
    }

    // Each face in a pixel once, with the part of the pixel's light that reaches the eye from its samples.
    void collect() {
        surface_of.assign(faces.size(), NONE);
        std::vector<Floats> passed(seen.top.size(), Floats{} + 1.0f / SAMPLES);  // through the layers in front
        for (auto layer = seen.layers.rbegin(); layer != seen.layers.rend(); ++layer) {
            Floats &through = passed[seen.block(*layer)];
            for (int p = 0; p < PIXELS; ++p) {
                float weight = 0;
                for (int i = SAMPLES * p; i < SAMPLES * (p + 1); ++i)
                    if (layer->samples >> i & 1) {
                        weight += through[i];
                        through[i] *= 1 - float(frame.piece[faces[layer->face].piece].opacity);
                    }
                if (weight > 0) add(*layer, p, weight);
            }
        }
        for (size_t block = 0; block < seen.top.size(); ++block) {
            const Ints top = seen.top[block];
            for (int i = 0; i < WIDTH; ++i) {
                bool counted = top[i] == NONE;
                for (int k = i & -SAMPLES; k < i; ++k) counted |= top[k] == top[i];
                if (counted) continue;
                float weight = 0;
                for (int k = i; k < (i | (SAMPLES - 1)) + 1; ++k) weight += top[k] == top[i] ? passed[block][k] : 0;
                add(seen.opaque[top[i]], i / SAMPLES, weight);
            }
        }
    }

    void look(const Fragment &f, int i, FragmentInputs &inputs) const {
        const Surface &surface = surfaces[surface_of[f.of.face]];
        const Attributes centre = at(surface, f.of, f.pixel, CENTRE), there = at(surface, f.of, f.pixel, f.of.place(f.pixel));
        const Texel texel = this->texel(frame.piece[faces[f.of.face].piece].texture, surface, f.of, f.pixel);
        for (int k = 0; k < 3; ++k) {
            inputs.position[k][i] = centre[POSITION + k], inputs.normal[k][i] = there[NORMAL + k];
            inputs.flat[k][i] = surface.flat[k], inputs.texel[k][i] = texel.c[k];
        }
    }

    void shade() const {
        const int64_t count = fragments.size(), high = pass.part[1] - pass.part[0], wide = pass.part[3] - pass.part[2];
        std::fill(pass.images, pass.images + pass.n_images * high * wide * 4, 0.0f);
        for (int64_t first = 0; first < count; first += WIDTH) {
            const int together = std::min<int64_t>(WIDTH, count - first);
            FragmentInputs inputs;
            for (int i = 0; i < WIDTH; ++i) look(fragments[first + std::min(i, together - 1)], i, inputs);
            const Vector position = vector(inputs.position), v = unit(all(frame.eye) - position);
            const Vector n = surface_normal(vector(inputs.normal), vector(inputs.flat), v);
            for (int64_t k = 0; k < pass.n_images; ++k) {
                const float *points = pass.points + 4 * pass.lights * k;
                const BrdfTerms terms = radiance(pass.ambients[k], points, pass.lights, position, v, n);
                for (int i = 0; i < together; ++i) {
                    const Fragment &f = fragments[first + i];
                    const int64_t piece = faces[f.of.face].piece, row = f.of.y(f.pixel) - pass.part[0];
                    const float *base = pass.colors + 3 * (k * frame.pieces + piece), opacity = frame.piece[piece].opacity;
                    float *out = pass.images + ((k * high + row) * wide + f.of.x(f.pixel) - pass.part[2]) * 4;
                    for (int c = 0; c < 3; ++c)
                        out[c] += f.weight * (base[c] * inputs.texel[c][i] * opacity * terms.body[i] + terms.coat[i]);
                    out[3] += f.weight * opacity;
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
            pass[p].shown = -1;
            if (!drawing.cover()) continue;
            drawing.collect();
            drawing.shade();
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
          FIELD(Piece, triangles) FIELD(Piece, holes) FIELD(Piece, opacity) FIELD(Piece, texture))
STRUCTURE(Frame, Frame,
          FIELD(Frame, width) FIELD(Frame, height) FIELD(Frame, pieces) FIELD(Frame, piece) FIELD(Frame, x)
          FIELD(Frame, y) FIELD(Frame, eye))
STRUCTURE(Pass, Pass,
          FIELD(Pass, clip) FIELD(Pass, world) FIELD(Pass, normal) FIELD(Pass, order) FIELD(Pass, closed)
          FIELD(Pass, part) FIELD(Pass, n_images) FIELD(Pass, lights) FIELD(Pass, ambients) FIELD(Pass, points)
          FIELD(Pass, colors) FIELD(Pass, images) FIELD(Pass, shown))
FUNCTION(raster_float)
