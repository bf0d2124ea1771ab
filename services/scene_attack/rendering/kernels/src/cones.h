// Which parts of the trees of bounding boxes the rays of a packet may meet, found without running them.

#pragma once

#include "rays.h"

namespace {

// A packet's rays within a texel start in a box and run in a cone of directions. Most cones meet no box of the tree's
// upper part, so that no ray has to run: CUT nodes cover all triangles, and each has a bit (a scene has
// fewer objects).
constexpr int CUT = 32;
constexpr F SLACK = 1e-4f;  // more than the rounding of a cosine or of where a ray meets a triangle

struct Cover {
    std::vector<int32_t> nodes, owners;  // owners: the objects' indices
    std::vector<F> centres, radii;  // of spheres around the nodes' boxes

    explicit Cover(const Tree &tree) : nodes(tree.roots) {
        while ((int)nodes.size() < CUT) {
            int widest = -1;
            for (int i = 0; i < (int)nodes.size(); ++i) {
                const Node &node = tree.nodes[nodes[i]];
                if (!node.count && (widest < 0 || node.box.area() > tree.nodes[nodes[widest]].box.area())) widest = i;
            }
            if (widest < 0) break;
            const int32_t at = nodes[widest];
            nodes[widest] = at + 1, nodes.push_back(tree.nodes[at].first);
        }
        // The largest hide most: the floor, from rays that lead down.
        std::stable_sort(nodes.begin(), nodes.end(), [&](int32_t a, int32_t b) {
            return tree.nodes[a].box.area() > tree.nodes[b].box.area();
        });
        for (int32_t at : nodes) {
            const Box &b = tree.nodes[at].box;
            F squares = 0;
            for (int k = 0; k < 3; ++k) {
                centres.push_back((b.low[k] + b.high[k]) / 2);
                squares += (b.high[k] - b.low[k]) * (b.high[k] - b.low[k]) / 4;
            }
            radii.push_back(std::sqrt(squares));
            const auto after = std::upper_bound(tree.roots.begin(), tree.roots.end(), at);  // a tree's nodes follow it
            owners.push_back(tree.owners[after - tree.roots.begin() - 1]);
        }
    }
};

// The cone and the box of each texel's directions, in vectors of N texels.
struct Cones {
    std::vector<Vec> axis[3], low[3], high[3], cosine, sine;  // cosine and sine of the half angle

    Cones(int64_t texels, int64_t samples, const F *towards) {
        const int64_t vectors = (texels + N - 1) / N;
        for (int k = 0; k < 3; ++k) axis[k].resize(vectors), low[k].resize(vectors), high[k].resize(vectors);
        cosine.resize(vectors), sine.resize(vectors);
        for (int64_t t = 0; t < vectors * N; ++t) {
            const F *w = towards + 3 * samples * std::min(t, texels - 1);
            F sum[3] = {}, least = 1;
            Box box;
            for (int64_t i = 0; i < samples; ++i) {
                box.add(w + 3 * i);
                for (int k = 0; k < 3; ++k) sum[k] += w[3 * i + k];
            }
            const F length = std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
            for (int k = 0; k < 3; ++k) sum[k] = length > 0 ? sum[k] / length : 0;
            for (int64_t i = 0; i < samples; ++i)
                least = std::min(least, w[3 * i] * sum[0] + w[3 * i + 1] * sum[1] + w[3 * i + 2] * sum[2]);
            for (int k = 0; k < 3; ++k) {
                axis[k][t / N][t % N] = sum[k];
                low[k][t / N][t % N] = box.low[k], high[k][t / N][t % N] = box.high[k];
            }
            // Directions that are no narrow cone may meet anything: a threshold of less than -1.
            cosine[t / N][t % N] = least > 0.1f ? least : -3;
            sine[t / N][t % N] = std::sqrt(std::max(0.0f, 1 - least * least));
        }
    }

    // Sets the bits of the nodes that rays from within `from` may meet, `into` [texels] in vectors.
    void meet(const Tree &tree, const Cover &cover, const Box &from, std::vector<Mask> &into) const {
        F centre[3], squares = 0;
        for (int k = 0; k < 3; ++k) {
            centre[k] = (from.low[k] + from.high[k]) / 2;
            squares += (from.high[k] - from.low[k]) * (from.high[k] - from.low[k]) / 4;
        }
        std::fill(into.begin(), into.end(), Mask{});
        for (int i = 0; i < (int)cover.nodes.size(); ++i) {
            const Box &box = tree.nodes[cover.nodes[i]].box;
            const F radius = (cover.radii[i] + std::sqrt(squares)) * (1 + SLACK);
            F to[3], length = 0;
            for (int k = 0; k < 3; ++k) to[k] = cover.centres[3 * i + k] - centre[k], length += to[k] * to[k];
            length = std::sqrt(length);
            const bool outside = length > radius;
            const F sine_of = outside ? radius / length : 1, cosine_of = std::sqrt(std::max(0.0f, 1 - sine_of * sine_of));
            for (int k = 0; k < 3; ++k) to[k] /= std::max(length, 1e-20f);
            for (size_t t = 0; t < into.size(); ++t) {
                Mask met = ~Mask{};
                if (outside)
                    met = axis[0][t] * to[0] + axis[1][t] * to[1] + axis[2][t] * to[2] + SLACK >=
                          cosine[t] * cosine_of - sine[t] * sine_of;
                for (int k = 0; k < 3; ++k) {  // the box lies where no direction leads
                    if (from.low[k] > box.high[k]) met &= low[k][t] < F(0);
                    if (from.high[k] < box.low[k]) met &= high[k][t] > F(0);
                }
                into[t] |= met & (int32_t)(1u << i);
            }
        }
    }
};

}  // namespace
