// The display's curve, and images over a ground (services/rendering/color.py and compositing.py).

#include "lanes.h"
#include "layout.h"

namespace {

constexpr double KNEE = 0.0031308;

// The sRGB curve on [0, 1], and its slope: zero outside. What is not a number stays so.
template <class T> struct Shown {
    V<T> value, slope;

    explicit Shown(V<T> linear) {
        V<T> c = choose<T>(linear < T(0), V<T>{}, choose<T>(linear > T(1), all<T>(1), linear));
        V<T> above = choose<T>(c > T(KNEE), c, all<T>(KNEE));
        V<T> curved = T(1.055) * exponential<T>(log_of<T>(above) * T(1 / 2.4));
        I<T> straight = c <= T(KNEE), number = c == c, inside = (linear >= T(0)) & (linear <= T(1));
        value = choose<T>(number, choose<T>(straight, T(12.92) * c, curved - T(0.055)), linear);
        V<T> steep = choose<T>(straight, all<T>(12.92), curved * T(1 / 2.4) / above);
        slope = choose<T>(number, (V<T>)((I<T>)steep & inside), linear);
    }
};

template <class T> void display(int64_t count, const T *linear, T *shown, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        const int64_t here = std::min<int64_t>(n, count - first);
        V<T> x{};
        std::memcpy(&x, linear + first, here * sizeof(T));
        x = Shown<T>(x).value;
        std::memcpy(shown + first, &x, here * sizeof(T));
    }
}

// Values as they are saved, bytes rounded to nearest (ties to even), and as a reader sees those. `count` values.
void save(int64_t count, const float *shown, uint8_t *bytes, float *seen, int threads) {
#pragma omp parallel for simd schedule(static) num_threads(threads)
    for (int64_t i = 0; i < count; ++i) {
        const float held = shown[i] > 0.0f ? shown[i] < 1.0f ? shown[i] : 1.0f : 0.0f;
        const float rounded = std::nearbyint(held * 255.0f);
        bytes[i] = (uint8_t)rounded;
        seen[i] = rounded / 255.0f;
    }
}

// The curve in place, of the three channels of as many pixels as there are lanes.
template <class T> void show(T *values) {
    for (int k = 0; k < 3; ++k) {
        V<T> x;
        std::memcpy(&x, values + k * Lanes<T>::count, sizeof x);
        x = Shown<T>(x).value;
        std::memcpy(values + k * Lanes<T>::count, &x, sizeof x);
    }
}

// Radiance times base colour of as many pixels as there are lanes: three vectors, in the order of memory.
template <class T> struct Pixels {
    static constexpr int n = Lanes<T>::count;
    int64_t here;
    V<T> color[3]{}, linear[3]{};

    Pixels(int64_t first, int64_t count, const T *radiance, const T *base_color) : here(std::min<int64_t>(n, count - first)) {
        std::memcpy(color, base_color + 3 * first, 3 * here * sizeof(T));
        std::memcpy(linear, radiance + 3 * first, 3 * here * sizeof(T));
        for (int k = 0; k < 3; ++k) linear[k] *= color[k];
    }
};

// coverage [count]; under [count, 3]; pixels [count] say where in image [., 3] each goes.
template <class T>
void composite(int64_t count, const T *radiance, const T *base_color, const T *coverage, const T *under,
               const int64_t *pixels, T *image, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        Pixels<T> of(first, count, radiance, base_color);
        T shown[3 * n];
        std::memcpy(shown, of.linear, sizeof shown);
        show<T>(shown);
        for (int64_t i = 0; i < of.here; ++i)
            for (int k = 0; k < 3; ++k)
                image[3 * pixels[first + i] + k] = under[3 * (first + i) + k] + coverage[first + i] * shown[3 * i + k];
    }
}

template <class T>
void composite_backward(int64_t count, const T *radiance, const T *base_color, const T *coverage,
                        const int64_t *pixels, const T *slope, T *d_radiance, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        Pixels<T> of(first, count, radiance, base_color);
        T steep[3 * n];
        for (int k = 0; k < 3; ++k) {
            V<T> value = Shown<T>(of.linear[k]).slope * of.color[k];
            std::memcpy(steep + k * n, &value, sizeof value);
        }
        for (int64_t i = 0; i < of.here; ++i)
            for (int k = 0; k < 3; ++k)
                d_radiance[3 * (first + i) + k] =
                    slope[3 * pixels[first + i] + k] * coverage[first + i] * steep[3 * i + k];
    }
}

// radiance [count, 4]: times coverage, and coverage; ground [3]; shown [count, 3].
template <class T>
void over_ground(int64_t count, const T *radiance, T exposure, const T *ground, T *shown, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        const int64_t here = std::min<int64_t>(n, count - first);
        T linear[3 * n] = {}, coverage[n] = {};
        for (int64_t i = 0; i < here; ++i) {
            const T *of = radiance + 4 * (first + i);
            const T bright = exposure / std::max(of[3], T(1e-6));
            coverage[i] = of[3];
            for (int k = 0; k < 3; ++k) linear[3 * i + k] = of[k] * bright;
        }
        show<T>(linear);
        for (int64_t i = 0; i < here; ++i)
            for (int k = 0; k < 3; ++k)
                shown[3 * (first + i) + k] = coverage[i] * linear[3 * i + k] + (1 - coverage[i]) * ground[k];
    }
}

}  // namespace

EXPORT void save_float(int64_t count, const float *shown, uint8_t *bytes, float *seen, int threads) {
    save(count, shown, bytes, seen, threads);
}

#define BOTH(T)                                                                                                        \
    EXPORT void display_##T(int64_t count, const T *linear, T *shown, int threads) {                                   \
        display<T>(count, linear, shown, threads);                                                                     \
    }                                                                                                                  \
    EXPORT void over_ground_##T(int64_t count, const T *radiance, T exposure, const T *ground, T *shown, int threads) {\
        over_ground<T>(count, radiance, exposure, ground, shown, threads);                                             \
    }                                                                                                                  \
    EXPORT void composite_##T(int64_t count, const T *radiance, const T *base_color, const T *coverage,                \
                              const T *under, const int64_t *pixels, T *image, int threads) {                        \
        composite<T>(count, radiance, base_color, coverage, under, pixels, image, threads);                          \
    }                                                                                                                  \
    EXPORT void composite_backward_##T(int64_t count, const T *radiance, const T *base_color, const T *coverage,       \
                                       const int64_t *pixels, const T *slope, T *d_radiance, int threads) {            \
        composite_backward<T>(count, radiance, base_color, coverage, pixels, slope, d_radiance, threads);              \
    }

BOTH(float)
BOTH(double)
FUNCTION(save_float)
FUNCTION(display_float)
FUNCTION(over_ground_float)
FUNCTION(composite_float)
FUNCTION(composite_backward_float)
FUNCTION(display_double)
FUNCTION(over_ground_double)
FUNCTION(composite_double)
FUNCTION(composite_backward_double)
