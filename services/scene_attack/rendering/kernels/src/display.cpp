// The sRGB curve, and compositing of images over a ground (services/scene_attack/rendering/color.py and compositing.py).

#include "lanes.h"
#include "layout.h"

namespace {

constexpr double KNEE = 0.0031308;

// The sRGB curve of values clipped to [0, 1], and its derivative, which is zero outside. NaN stays NaN.
template <class T> struct SrgbCurve {
    V<T> value, derivative;

    explicit SrgbCurve(V<T> linear) {
        V<T> c = choose<T>(linear < T(0), V<T>{}, choose<T>(linear > T(1), all<T>(1), linear));
        V<T> above = choose<T>(c > T(KNEE), c, all<T>(KNEE));
        V<T> curved = T(1.055) * exponential<T>(log_of<T>(above) * T(1 / 2.4));
        I<T> straight = c <= T(KNEE), number = c == c, inside = (linear >= T(0)) & (linear <= T(1));
        value = choose<T>(number, choose<T>(straight, T(12.92) * c, curved - T(0.055)), linear);
        V<T> slope = choose<T>(straight, all<T>(12.92), curved * T(1 / 2.4) / above);
        derivative = choose<T>(number, (V<T>)((I<T>)slope & inside), linear);
    }
};

template <class T> void display(int64_t count, const T *linear, T *shown, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        const int64_t here = std::min<int64_t>(n, count - first);
        V<T> x{};
        std::memcpy(&x, linear + first, here * sizeof(T));
        x = SrgbCurve<T>(x).value;
        std::memcpy(shown + first, &x, here * sizeof(T));
    }
}

// `count` values rounded to 8 bits (to nearest, ties to even): as bytes, and as the multiples of 1/255 they stand for.
void save(int64_t count, const float *shown, uint8_t *bytes, float *seen, int threads) {
#pragma omp parallel for simd schedule(static) num_threads(threads)
    for (int64_t i = 0; i < count; ++i) {
        const float held = shown[i] > 0.0f ? shown[i] < 1.0f ? shown[i] : 1.0f : 0.0f;
        const float rounded = std::nearbyint(held * 255.0f);
        bytes[i] = (uint8_t)rounded;
        seen[i] = rounded / 255.0f;
    }
}

// Applies the sRGB curve in place to the three channels of one block of pixels, one pixel per lane.
template <class T> void show(T *values) {
    for (int k = 0; k < 3; ++k) {
        V<T> x;
        std::memcpy(&x, values + k * Lanes<T>::count, sizeof x);
        x = SrgbCurve<T>(x).value;
        std::memcpy(values + k * Lanes<T>::count, &x, sizeof x);
    }
}

// Radiance times base colour of a block of pixels, one per lane: 3 * n values in memory order, held in three vectors.
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

// radiance, base_color [count, 3]; coverage [count]; under [count, 3], the ground times 1 - coverage. pixels [count] holds
// each pixel's index in image [., 3].
template <class T>
void composite(int64_t count, const T *radiance, const T *base_color, const T *coverage, const T *under,
               const int64_t *pixels, T *image, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        Pixels<T> block(first, count, radiance, base_color);
        T shown[3 * n];
        std::memcpy(shown, block.linear, sizeof shown);
        show<T>(shown);
        for (int64_t i = 0; i < block.here; ++i)
            for (int k = 0; k < 3; ++k)
                image[3 * pixels[first + i] + k] = under[3 * (first + i) + k] + coverage[first + i] * shown[3 * i + k];
    }
}

template <class T>
void composite_backward(int64_t count, const T *radiance, const T *base_color, const T *coverage,
                        const int64_t *pixels, const T *d_image, T *d_radiance, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        Pixels<T> block(first, count, radiance, base_color);
        T derivative[3 * n];
        for (int k = 0; k < 3; ++k) {
            V<T> value = SrgbCurve<T>(block.linear[k]).derivative * block.color[k];
            std::memcpy(derivative + k * n, &value, sizeof value);
        }
        for (int64_t i = 0; i < block.here; ++i)
            for (int k = 0; k < 3; ++k)
                d_radiance[3 * (first + i) + k] =
                    d_image[3 * pixels[first + i] + k] * coverage[first + i] * derivative[3 * i + k];
    }
}

// radiance [count, 4]: RGB radiance times coverage, and coverage; ground [3], displayed; shown [count, 3].
template <class T>
void over_ground(int64_t count, const T *radiance, T exposure, const T *ground, T *shown, int threads) {
    const int n = Lanes<T>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        const int64_t here = std::min<int64_t>(n, count - first);
        T linear[3 * n] = {}, coverage[n] = {};
        for (int64_t i = 0; i < here; ++i) {
            const T *pixel = radiance + 4 * (first + i);
            const T bright = exposure / std::max(pixel[3], T(1e-6));
            coverage[i] = pixel[3];
            for (int k = 0; k < 3; ++k) linear[3 * i + k] = pixel[k] * bright;
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
                                       const int64_t *pixels, const T *d_image, T *d_radiance, int threads) {            \
        composite_backward<T>(count, radiance, base_color, coverage, pixels, d_image, d_radiance, threads);              \
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
