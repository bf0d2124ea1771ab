// Averages the samples of a G-buffer to pixels (services/scene_attack/rendering/opengl/gbuffer.py).

#include "lanes.h"
#include "layout.h"

namespace {

// The image has height x width pixels with factor x factor samples each. geometry [samples, 4]: normal and depth; surface
// [samples, 4]: colour and the object's number from 1, both 0 where nothing is covered. color and depth are means, depth
// over the samples of the pixel's majority object; owner is that object's index from 0, or -1; normals are sums.
void average(int64_t height, int64_t width, int64_t factor, int64_t objects, const float *geometry,
             const float *surface, float *normals, float *coverage, float *color, float *depth, int64_t *owner,
             int threads) {
    const float samples = float(factor * factor);
#pragma omp parallel num_threads(threads)
    {
        std::vector<float> votes(objects), depths(objects);
#pragma omp for schedule(static)
        for (int64_t pixel = 0; pixel < height * width; ++pixel) {
            const int64_t row = pixel / width * factor, column = pixel % width * factor;
            std::fill(votes.begin(), votes.end(), 0.0f);
            std::fill(depths.begin(), depths.end(), 0.0f);
            float sums[6] = {};
            float covered = 0;
            for (int64_t i = row; i < row + factor; ++i)
                for (int64_t j = column; j < column + factor; ++j) {
                    const int64_t at = 4 * (i * width * factor + j);
                    const int64_t number = (int64_t)surface[at + 3];
                    if (number == 0) continue;
                    for (int k = 0; k < 3; ++k) sums[k] += geometry[at + k], sums[3 + k] += surface[at + k];
                    votes[number - 1] += 1, depths[number - 1] += geometry[at + 3], covered += 1;
                }
            const int64_t most = std::max_element(votes.begin(), votes.end()) - votes.begin();
            for (int k = 0; k < 3; ++k) {
                normals[3 * pixel + k] = sums[k];
                color[3 * pixel + k] = sums[3 + k] / std::max(covered, 1.0f);
            }
            coverage[pixel] = covered / samples;
            depth[pixel] = depths[most] / std::max(votes[most], 1.0f);
            owner[pixel] = covered > 0 ? most : -1;
        }
    }
}

}  // namespace

EXPORT void average_float(int64_t height, int64_t width, int64_t factor, int64_t objects, const float *geometry,
                          const float *surface, float *normals, float *coverage, float *color, float *depth,
                          int64_t *owner, int threads) {
    average(height, width, factor, objects, geometry, surface, normals, coverage, color, depth, owner, threads);
}
FUNCTION(average_float)
