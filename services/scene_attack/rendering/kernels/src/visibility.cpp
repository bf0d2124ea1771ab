// Which directions the surface at each pixel sees past the scene's triangles, and where rays from the camera meet them
// (services/scene_attack/rendering/torch/surfaces.py).
//
// The rays of a shadow packet are parallel and start at neighbouring pixels, so that they mostly meet the same boxes.

#include "cones.h"
#include "layout.h"

namespace {

// out [directions, pixels]: 255 times the share of a direction's samples that nothing hides, among those above the
// pixel's own horizon, of its normal and of the triangle that it is on; 255 where none is. Triangles [faces, 3, 3];
// origins, normals and facets (the triangles' normals) [pixels, 3]; towards [directions, samples, 3], unit. A pixel's
// place in a row of `out` is in `columns` and in `owners` [pixels] the convex
// object that it is on, which casts no shadow there, or -1. `ends` [objects + 1] are as in Tree; balls
// [objects, 4] are inside the objects: centre and radius, which may be 0.
void visibility(int64_t objects, const int64_t *ends, const F *triangles, const F *balls, int64_t pixels,
                const F *origins, const F *normals, const F *facets, const int64_t *owners, const int64_t *columns,
                int64_t directions, int64_t samples, const F *towards, uint8_t *out, int threads) {
    const Tree tree(objects, ends, triangles);
    const Cover cover(tree);
    const Cones cones(directions, samples, towards);
    const int64_t blocks = (pixels + N - 1) / N;
#pragma omp parallel num_threads(threads)
    {
        std::vector<Mask> met(cones.cosine.size());
#pragma omp for schedule(dynamic, 4)
        for (int64_t block = 0; block < blocks; ++block) {
            const int64_t first = block * N;
            const int here = (int)std::min<int64_t>(N, pixels - first);
            Packet packet;
            Vec n[3], f[3];
            Mask real{}, owner{};
            Box from;
            for (int l = 0; l < N; ++l) {
                const int64_t p = first + std::min(l, here - 1);
                from.add(origins + 3 * p);
                for (int k = 0; k < 3; ++k) {
                    packet.o[k][l] = origins[3 * p + k];
                    n[k][l] = normals[3 * p + k], f[k][l] = facets[3 * p + k];
                }
                real[l] = l < here ? -1 : 0, owner[l] = (int32_t)owners[p];
            }
            cones.meet(tree, cover, from, met);
            for (int64_t d = 0; d < directions; ++d) {
                int above[N] = {}, seen[N] = {};
                uint8_t *row = out + d * pixels;
                const uint32_t nodes = (uint32_t)met[d / N][d % N];
                for (int64_t s = 0; nodes && s < samples; ++s) {
                    const F *w = towards + 3 * (d * samples + s);
                    Mask up = (n[0] * w[0] + n[1] * w[1] + n[2] * w[2] > F(0)) & real;
                    up &= f[0] * w[0] + f[1] * w[1] + f[2] * w[2] > F(0);
                    if (!any(up)) continue;
                    packet.aim(w);
                    packet.nearest = all<F>(FAR), packet.running = up;
                    for (uint32_t left = nodes; left; left &= left - 1) {
                        const int node = __builtin_ctz(left);
                        const Mask apart = packet.running & (owner == cover.owners[node]);
                        packet.running &= ~apart;
                        packet.stop_at(balls + 4 * cover.owners[node]);
                        if (any(packet.running)) packet.run(tree, cover.nodes[node], true, nullptr);
                        packet.running |= apart;
                    }
                    for (int l = 0; l < here; ++l) above[l] -= up[l], seen[l] -= up[l] & packet.running[l];
                }
                for (int l = 0; l < here; ++l)
                    row[columns[first + l]] =
                        above[l] ? (uint8_t)((510 * seen[l] + above[l]) / (2 * above[l])) : 255;
            }
        }
    }
}

// Where rays from one point first meet the triangles: distances [rays], 3e38 where they do not, and the faces' numbers
// there. directions [rays, 3], unit; `ends` as in Tree.
void nearest(int64_t objects, const int64_t *ends, const F *triangles, int64_t rays, const F *from, const F *directions,
             F *distances, int32_t *found, int threads) {
    const Tree tree(objects, ends, triangles);
    const int64_t blocks = (rays + N - 1) / N;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads)
    for (int64_t block = 0; block < blocks; ++block) {
        const int64_t first = block * N;
        const int here = (int)std::min<int64_t>(N, rays - first);
        Packet packet;
        int32_t own[N];
        for (int l = 0; l < N; ++l) {
            packet.aim(l, directions + 3 * (first + std::min(l, here - 1)));
            for (int k = 0; k < 3; ++k) packet.o[k][l] = from[k];
            own[l] = -1;
        }
        packet.nearest = all<F>(FAR), packet.running = ~Mask{};
        for (int32_t root : tree.roots) packet.run(tree, root, false, own);
        for (int l = 0; l < here; ++l) distances[first + l] = packet.nearest[l], found[first + l] = own[l];
    }
}

}  // namespace

EXPORT void visibility_float(int64_t objects, const int64_t *ends, const float *triangles,
                             const float *balls, int64_t pixels, const float *origins, const float *normals, const float *facets,
                             const int64_t *owners, const int64_t *columns, int64_t directions, int64_t samples,
                             const float *towards, uint8_t *out, int threads) {
    visibility(objects, ends, triangles, balls, pixels, origins, normals, facets, owners, columns, directions,
               samples, towards, out, threads);
}
EXPORT void nearest_hits_float(int64_t objects, const int64_t *ends, const float *triangles, int64_t rays,
                               const float *from, const float *directions, float *distances, int32_t *found,
                               int threads) {
    nearest(objects, ends, triangles, rays, from, directions, distances, found, threads);
}
FUNCTION(visibility_float)
FUNCTION(nearest_hits_float)
