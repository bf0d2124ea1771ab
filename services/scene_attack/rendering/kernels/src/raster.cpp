// Images of a scene: which faces are seen first (coverage.h), then only these are shaded (radiance.h), each pixel of
// each once for all images of a pass.

#include "radiance.h"

namespace {

enum { POSITION = 0, NORMAL = 3, UV = 6, INVERSE_W = 8 };  // where a vector holds the attributes of a face
constexpr int FEW = 4;  // pixels that may see a face from its edge, so that it lies elsewhere at their centre

struct Face { int32_t piece, corners[3]; };

// A fragment's pixel that is seen: its number in the block, column, row, and share of the pixel's light.
struct Pixel : Fragment {
    int32_t number, x, y;
    float weight;
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
        const Piece &piece = frame.piece[face.piece];
        const Corners &of = corners[face.piece];
        const float *world = pass.world + 16 * face.piece, *turn = pass.normal + 9 * face.piece;
        Floats corner[3] = {};
        for (int i = 0; i < 3; ++i) {
            const float *p = piece.positions + 3 * face.corners[i], *n = piece.normals + 3 * face.corners[i];
            for (int k = 0; k < 3; ++k) {
                const float *a = world + 4 * k, *b = turn + 3 * k;
                corner[i][POSITION + k] = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + a[3];
                corner[i][NORMAL + k] = b[0] * n[0] + b[1] * n[1] + b[2] * n[2];
            }
            for (int k = 0; k < 2 && piece.uv; ++k) corner[i][UV + k] = piece.uv[2 * face.corners[i] + k];
            corner[i][INVERSE_W] = 1;
        }
        const Floats b = corner[1] - corner[0], c = corner[2] - corner[0];
        const float flat[] = {b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]};
        for (int i = 0; i < 3; ++i) corner[i] *= of.w[face.corners[i]];
        return {{of, face.corners, corner[0], corner[1], corner[2]}, {flat[0], flat[1], flat[2]}};
    }

    Texel texel(const Texture &texture, const Surface &surface, const Fragment &f, int pixel) const {
        if (!texture.levels) return Texel{} + 1;
        const auto at = [&](int number) {
            const auto [x, y] = seen.pixel(f.block, number);
            return surface.at({x + 0.5f, y + 0.5f});
        };
        const Floats first = at(0), here = pixel ? at(pixel) : first, right = at(1) - first, up = at(SIDE) - first;
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
                const int64_t area = corners[i].area(t);
                if (area == 0 || (area < 0 && f < pass.n_watertight_faces[i])) continue;
                if (area < 0) std::swap(face.corners[1], face.corners[2]);
                const auto solid = [&](const Fragment &at) {
                    Floats alpha = Floats{} + 1;
                    for (int s = 0; s < WIDTH && piece.holes; ++s)
                        if (at.nearest >> s & 1) alpha[s] = texel(piece.texture, surface(face), at, s / SAMPLES)[3];
                    return alpha >= 0.5f;
                };
                seen.draw(corners[i], face.corners, faces.size(), piece.opacity < 1, solid);
                faces.push_back(face);
            }
        }
        return true;
    }

    const Piece &piece(const Fragment &fragment) const { return frame.piece[faces[fragment.face].piece]; }

    // The fragments' pixels from which light reaches the eye, in the order they are drawn.
    std::vector<Pixel> weighed() const {
        std::vector<Pixel> pixels;
        std::vector<Floats> passed(seen.top.size(), Floats{} + 1.0f / SAMPLES);  // through the layers in front
        for (int32_t k = seen.fragments.size(); k-- > 0;) {
            const Fragment &f = seen.fragments[k];
            const float opacity = piece(f).opacity;
            const uint32_t shown = opacity < 1 ? f.solid : bits_of(seen.top[f.block] == k);
            for (int p = 0; p < PIXELS && shown; ++p) {
                const auto [x, y] = seen.pixel(f.block, p);
                float weight = 0;
                for (int s = SAMPLES * p; s < SAMPLES * (p + 1); ++s)
                    if (shown >> s & 1) weight += passed[f.block][s], passed[f.block][s] *= 1 - opacity;
                if (weight > 0 && y >= pass.part[0] && y < pass.part[1] && x >= pass.part[2] && x < pass.part[3])
                    pixels.push_back({f, p, x, y, weight});
            }
        }
        std::reverse(pixels.begin(), pixels.end());
        return pixels;
    }

    // How many faces are seen; -1 if more than FEW pixels see a face from its edge.
    int64_t shade() {
        const std::vector<Pixel> pixels = weighed();
        const int64_t high = pass.part[1] - pass.part[0], wide = pass.part[3] - pass.part[2];
        int64_t faces_seen = 0, on_edge = 0;
        Surface surface;  // of the last fragment's face
        for (size_t first = 0; first < pixels.size(); first += WIDTH) {
            const Pixel *group = pixels.data() + first;
            const int together = std::min<int64_t>(WIDTH, pixels.size() - first);
            Floats position[3] = {}, normal[3] = {}, flat[3] = {}, texels[3] = {};
            Floats metallic = {}, roughness = {};
            for (int i = 0; i < together; ++i) {
                const Pixel &f = group[i];
                metallic[i] = piece(f).metallic, roughness[i] = piece(f).roughness;
                if (first + i == 0 || f.face != group[i - 1].face) {
                    surface = this->surface(faces[f.face]);
                    ++faces_seen;
                }
                const Floats centre = surface.at({f.x + 0.5f, f.y + 0.5f}), place = surface.at(seen.place(f, f.number));
                const Texel texel = this->texel(piece(f).texture, surface, f, f.number);
                on_edge += !(std::abs(place[INVERSE_W] - 1) < 0.25f);  // nearer or farther by a quarter
                for (int k = 0; k < 3; ++k) {
                    position[k][i] = centre[POSITION + k], normal[k][i] = place[NORMAL + k];
                    flat[k][i] = surface.flat[k], texels[k][i] = texel[k];
                }
            }
            const Vector p = vector(position), v = unit(all(pass.eye) - p);
            const Vector n = surface_normal(vector(normal), vector(flat), v);
            const uint32_t metals = bits_of(metallic >= 0.0f), all_of_them = (1u << together) - 1;
            for (int64_t k = 0; k < pass.n_images; ++k) {
                const auto base = [&](int i) { return pass.colors + 3 * (k * frame.pieces + faces[group[i].face].piece); };
                BrdfTerms terms{};
                if (~metals & all_of_them) terms = radiance(pass, k, p, v, n);
                Floats reflected[3] = {};
                if (metals & all_of_them) {
                    for (int i = 0; i < together; ++i)
                        for (int c = 0; c < 3; ++c) reflected[c][i] = base(i)[c] * texels[c][i];
                    metallic_radiance(pass, k, p, v, n, metallic, roughness, reflected);
                }
                for (int i = 0; i < together; ++i) {
                    const Pixel &f = group[i];
                    const float opacity = piece(f).opacity;
                    float *out = pass.images + ((k * high + f.y - pass.part[0]) * wide + f.x - pass.part[2]) * 4;
                    for (int c = 0; c < 3; ++c)
                        out[c] += f.weight * (metals >> i & 1 ? reflected[c][i]
                                                              : base(i)[c] * texels[c][i] * opacity * terms.body[i] + terms.coat[i]);
                    out[3] += f.weight * opacity;
                }
            }
        }
        return on_edge > FEW ? -1 : faces_seen;
    }
};

}  // namespace

// `n_seen` [passes]: the faces seen; -1: images that are not to be used (Drawing::cover, Drawing::shade).
EXPORT void raster_float(const Frame *frame, int64_t passes, const Pass *pass, int64_t *n_seen, int threads) {
#pragma omp parallel for schedule(dynamic) num_threads(threads)
    for (int64_t p = 0; p < passes; ++p) {
        Drawing drawing(*frame, pass[p]);
        n_seen[p] = drawing.cover() ? drawing.shade() : -1;
    }
}

STRUCTURE(Texture, Texture, "Texture", FIELD(Texture, levels) FIELD(Texture, texels) FIELD(Texture, sizes))
STRUCTURE(Piece, Piece, "Piece",
          FIELD(Piece, corners) FIELD(Piece, faces) FIELD(Piece, positions) FIELD(Piece, normals) FIELD(Piece, uv)
          FIELD(Piece, triangles) FIELD(Piece, holes) FIELD(Piece, opacity) FIELD(Piece, metallic)
          FIELD(Piece, roughness) FIELD(Piece, texture))
STRUCTURE(Frame, Frame, "Frame",
          FIELD(Frame, width) FIELD(Frame, height) FIELD(Frame, pieces) FIELD(Frame, piece) FIELD(Frame, x)
          FIELD(Frame, y))
STRUCTURE(Pass, Pass, "Pass",
          FIELD(Pass, eye) FIELD(Pass, clip) FIELD(Pass, world) FIELD(Pass, normal) FIELD(Pass, order) FIELD(Pass, n_watertight_faces)
          FIELD(Pass, part) FIELD(Pass, n_images) FIELD(Pass, lights) FIELD(Pass, ambients) FIELD(Pass, points)
          FIELD(Pass, colors) FIELD(Pass, images))
FUNCTION(raster_float)
