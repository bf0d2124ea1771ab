// Images of a scene: which faces are seen first (coverage.h), then only these are shaded (radiance.h), each pixel of
// each once for all images of a pass.

#include <atomic>
#include <thread>

#include "coverage.h"
#include "radiance.h"

namespace {

// Where the attributes of a face lie in a vector: position, normal, texture coordinates, 1.
enum { POSITION = 0, NORMAL = 3, UV = 6, INVERSE_W = 8 };

struct Face {
    int32_t piece, corners[3];
};

// Attributes over w: linear over the image. Perspective is that of a pixel's centre, wherever in the pixel they are.
struct Surface : Linear<Floats> {
    float flat[3];  // a normal of the face's plane

    Floats at(std::pair<float, float> place) const {
        const auto [x, y] = place;
        const float dx = std::floor(x) + 0.5f - this->x, dy = std::floor(y) + 0.5f - this->y;
        return Linear::at(x, y) * (1 / (start[INVERSE_W] + dx * right[INVERSE_W] + dy * up[INVERSE_W]));
    }
};

struct Drawing {
    const Frame &frame;
    const Pass &pass;
    Visibility seen;
    std::vector<Corners> corners;
    std::vector<Face> faces;  // those drawn

    Drawing(const Frame &frame, const Pass &pass) : frame(frame), pass(pass), seen(frame, pass.part) {}

    Surface surface(const Face &face) const {
        float flat[3];
        const Piece &piece = frame.piece[face.piece];
        const Corners &of = corners[face.piece];
        const float *world = pass.world + 16 * face.piece, *turn = pass.normal + 9 * face.piece;
        float at[3][WIDTH] = {};
        for (int i = 0; i < 3; ++i) {
            const float *p = piece.positions + 3 * face.corners[i], *n = piece.normals + 3 * face.corners[i];
            for (int k = 0; k < 3; ++k) {
                const float *a = world + 4 * k, *b = turn + 3 * k;
                at[i][POSITION + k] = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + a[3];
                at[i][NORMAL + k] = b[0] * n[0] + b[1] * n[1] + b[2] * n[2];
            }
            for (int k = 0; k < 2 && piece.uv; ++k) at[i][UV + k] = piece.uv[2 * face.corners[i] + k];
            at[i][INVERSE_W] = 1;
        }
        Floats corner[3];
        std::memcpy(corner, at, sizeof corner);
        const Floats b = corner[1] - corner[0], c = corner[2] - corner[0];
        for (int k = 0; k < 3; ++k) flat[k] = b[(k + 1) % 3] * c[(k + 2) % 3] - b[(k + 2) % 3] * c[(k + 1) % 3];
        for (int i = 0; i < 3; ++i) corner[i] *= of.w[face.corners[i]];
        return {{of, face.corners, corner[0], corner[1], corner[2]}, {flat[0], flat[1], flat[2]}};
    }

    Texel texel(const Texture &texture, const Surface &surface, const Fragment &f) const {
        if (!texture.levels) return Texel{} + 1;
        const auto at = [&](int pixel) { return surface.at(seen.place(f, pixel)); };
        const Floats first = at(0), here = f.pixel ? at(f.pixel) : first, right = at(1) - first, up = at(SIDE) - first;
        return sample(texture, here[UV], here[UV + 1], right[UV], right[UV + 1], up[UV], up[UV + 1]);
    }

    // False if a face reaches to the near plane or far beyond the frame.
    bool cover() {
        for (int64_t i = 0; i < frame.pieces; ++i) {
            corners.emplace_back(frame.piece[i], pass.clip + 16 * i, frame);
            if (!corners.back().drawable) return false;
        }
        for (int64_t k = 0; k < frame.pieces; ++k) {
            const int32_t i = pass.order[k];
            const Piece &piece = frame.piece[i];
            for (int64_t f = 0; f < piece.faces; ++f) {
                const int32_t *t = piece.triangles + 3 * f;
                Face face{i, {t[0], t[1], t[2]}};
                const float area = corners[i].area(t);
                if (area == 0 || (area < 0 && f < pass.n_watertight_faces[i])) continue;
                if (area < 0) std::swap(face.corners[1], face.corners[2]);
                const auto is_hole = [&](const Fragment &at) {
                    return piece.holes && texel(piece.texture, surface(face), at)[3] < 0.5f;
                };
                seen.draw(corners[i], face.corners, faces.size(), piece.opacity < 1, is_hole);
                faces.push_back(face);
            }
        }
        return true;
    }

    const Piece &piece(const Fragment &fragment) const { return frame.piece[faces[fragment.face].piece]; }

    // Each fragment's share of its pixel's light that reaches the eye. Only fragments with one are left.
    void weigh() {
        std::vector<Floats> passed(seen.top.size(), Floats{} + 1.0f / SAMPLES);  // through the layers in front
        std::vector<Fragment> &all = seen.fragments;
        for (auto layer = all.rbegin(); layer != all.rend() && piece(*layer).opacity < 1; ++layer)
            for (int i = 0; i < WIDTH; ++i)
                if (layer->samples() >> i & 1) {
                    layer->weight += passed[layer->block][i];
                    passed[layer->block][i] *= 1 - float(piece(*layer).opacity);
                }
        for (size_t block = 0; block < seen.top.size(); ++block)
            for (int i = 0; i < WIDTH; ++i)
                if (seen.top[block][i] != NONE) all[seen.top[block][i]].weight += passed[block][i];
        all.erase(std::remove_if(all.begin(), all.end(), [](const Fragment &f) { return f.weight == 0; }), all.end());
    }

    // How many faces are seen.
    int64_t shade() {
        weigh();
        const int64_t count = seen.fragments.size();
        const int64_t high = pass.part[1] - pass.part[0], wide = pass.part[3] - pass.part[2];
        std::fill(pass.images, pass.images + pass.n_images * high * wide * 4, 0.0f);
        int64_t faces_seen = 0;
        Surface surface;  // of the last fragment's face
        for (int64_t first = 0; first < count; first += WIDTH) {
            const Fragment *fragments = seen.fragments.data() + first;
            const int together = std::min<int64_t>(WIDTH, count - first);
            Floats position[3] = {}, normal[3] = {}, flat[3] = {}, texels[3] = {};
            for (int i = 0; i < together; ++i) {
                const Fragment &f = fragments[i];
                if (first + i == 0 || f.face != fragments[i - 1].face) {
                    surface = this->surface(faces[f.face]);
                    ++faces_seen;
                }
                const Floats centre = surface.at({f.x() + 0.5f, f.y() + 0.5f});
                const Floats place = surface.at(seen.place(f, f.pixel));
                const Texel texel = this->texel(piece(f).texture, surface, f);
                for (int k = 0; k < 3; ++k) {
                    position[k][i] = centre[POSITION + k], normal[k][i] = place[NORMAL + k];
                    flat[k][i] = surface.flat[k], texels[k][i] = texel[k];
                }
            }
            const Vector p = vector(position), v = unit(all(frame.eye) - p);
            const Vector n = surface_normal(vector(normal), vector(flat), v);
            for (int64_t k = 0; k < pass.n_images; ++k) {
                const float *points = pass.points + 4 * pass.lights * k;
                const BrdfTerms terms = radiance(pass.ambients[k], points, pass.lights, p, v, n);
                for (int i = 0; i < together; ++i) {
                    const Fragment &f = fragments[i];
                    const float *base = pass.colors + 3 * (k * frame.pieces + faces[f.face].piece);
                    const float opacity = piece(f).opacity;
                    float *out = pass.images + ((k * high + f.y() - pass.part[0]) * wide + f.x() - pass.part[2]) * 4;
                    for (int c = 0; c < 3; ++c)
                        out[c] += f.weight * (base[c] * texels[c][i] * opacity * terms.body[i] + terms.coat[i]);
                    out[3] += f.weight * opacity;
                }
            }
        }
        return faces_seen;
    }
};

}  // namespace

EXPORT void raster_float(const Frame *frame, int64_t passes, Pass *pass, int threads) {
    std::atomic<int64_t> next{0};
    auto work = [&] {
        for (int64_t p; (p = next++) < passes;) {
            Drawing drawing(*frame, pass[p]);
            pass[p].shown = -1;
            if (drawing.cover()) pass[p].shown = drawing.shade();
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
          FIELD(Pass, clip) FIELD(Pass, world) FIELD(Pass, normal) FIELD(Pass, order) FIELD(Pass, n_watertight_faces)
          FIELD(Pass, part) FIELD(Pass, n_images) FIELD(Pass, lights) FIELD(Pass, ambients) FIELD(Pass, points)
          FIELD(Pass, colors) FIELD(Pass, images) FIELD(Pass, shown))
FUNCTION(raster_float)
