// The shading sum over directions and lobes for a viewer at a finite distance (perspective.h), for Python.

#include "layout.h"
#include "perspective.h"

#define BOTH(T, NAME)                                                                                                  \
    EXPORT void shade_perspective_##NAME(const Scene<T> *s, T *out, int threads) {                                     \
        if (s->visibility) return shade_perspective_shadows(s, out, threads);                                          \
        s->channels == 1 ? forward<T, 1, false>(*s, out, threads) : forward<T, 3, false>(*s, out, threads);            \
    }                                                                                                                  \
    EXPORT void shade_perspective_backward_##NAME(const Scene<T> *s, const T *d_out, T *d_light, T *d_material,        \
                                                  T *d_normals, int threads) {                                         \
        if (s->visibility)                                                                                             \
            return shade_perspective_shadows_backward(s, d_out, d_light, d_material, d_normals, threads);              \
        s->channels == 1 ? backward<T, 1, false>(*s, d_out, d_light, d_material, d_normals, threads)                   \
                         : backward<T, 3, false>(*s, d_out, d_light, d_material, d_normals, threads);                  \
    }

#define DESCRIBE(T)                                                                                                    \
    STRUCTURE(Scene<T>, T, "perspective.Scene." #T,                                                                    \
              FIELD(Scene<T>, count) FIELD(Scene<T>, directions) FIELD(Scene<T>, channels) FIELD(Scene<T>, lobes)      \
              FIELD(Scene<T>, normals) FIELD(Scene<T>, viewers) FIELD(Scene<T>, towards) FIELD(Scene<T>, light)        \
              FIELD(Scene<T>, material) FIELD(Scene<T>, visibility)                       \
              FIELD(Scene<T>, cosine_floor) FIELD(Scene<T>, lowest)                          \
              FIELD(Scene<T>, highest) FIELD(Scene<T>, max_log_kappa) FIELD(Scene<T>, max_log_gamma))                        \
    FUNCTION(shade_perspective_##T) FUNCTION(shade_perspective_backward_##T)

BOTH(float, float)
BOTH(double, double)
DESCRIBE(float)
DESCRIBE(double)
