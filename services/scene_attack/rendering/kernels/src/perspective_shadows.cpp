// The sums of perspective.h in scenes with shadows.

#include "perspective.h"

#define DEFINE(T)                                                                                                      \
    void shade_perspective_shadows(const void *scene, T *out, int threads) {                                           \
        const Scene<T> &s = *(const Scene<T> *)scene;                                                                  \
        s.channels == 1 ? forward<T, 1, true>(s, out, threads) : forward<T, 3, true>(s, out, threads);                 \
    }                                                                                                                  \
    void shade_perspective_shadows_backward(const void *scene, const T *d_out, T *d_light, T *d_material,              \
                                            T *d_normals, int threads) {                                               \
        const Scene<T> &s = *(const Scene<T> *)scene;                                                                  \
        s.channels == 1 ? backward<T, 1, true>(s, d_out, d_light, d_material, d_normals, threads)                      \
                        : backward<T, 3, true>(s, d_out, d_light, d_material, d_normals, threads);                     \
    }

DEFINE(float)
DEFINE(double)
