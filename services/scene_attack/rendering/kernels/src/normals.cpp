// Unit normals from azimuth and polar angle, and the gradient with respect to the angles
// (services/scene_attack/rendering/torch/table.py).

#include "lanes.h"
#include "layout.h"

namespace {

// Sine and cosine of float angles, computed in double: correct to within one unit in the last place of a float.
struct Turn {
    typedef Lanes<double> L;
    V<double> sine, cosine;

    explicit Turn(V<double> angle) {
        I<double> far = !(angle >= -MAX_REDUCED) | !(angle <= MAX_REDUCED);  // or NaN
        bool any = false;
        for (int i = 0; i < L::count; ++i) any |= far[i] != 0;
        if (any) {
            for (int i = 0; i < L::count; ++i) sine[i] = std::sin(angle[i]), cosine[i] = std::cos(angle[i]);
            return;
        }
        // Range reduction: the nearest multiple of a quarter turn, and the remainder r, at most an eighth of a turn.
        V<double> shifted = angle * (2 / PI) + L::round_magic, quarters = shifted - L::round_magic;
        I<double> quarter = (I<double>)shifted - (I<double>)all<double>(L::round_magic);
        V<double> r = angle - quarters * (PI / 2), z = r * r;
        V<double> s = all<double>(1), c = all<double>(1);
        for (int k = 6; k > 0; --k) {
            s = 1.0 - s * z * (1.0 / (2 * k * (2 * k + 1)));
            c = 1.0 - c * z * (1.0 / (2 * k * (2 * k - 1)));
        }
        s *= r;
        I<double> odd = -(quarter & 1);
        I<double> down = (quarter & 2) << 62, back = ((quarter + 1) & 2) << 62;  // shifted to the sign bit
        sine = (V<double>)((I<double>)choose<double>(odd, c, s) ^ down);
        cosine = (V<double>)((I<double>)choose<double>(odd, s, c) ^ back);
    }

    static constexpr double PI = 3.14159265358979323846;
    static constexpr double MAX_REDUCED = 1e6;  // larger angles use std::sin; the range reduction is off by 1e-10 here
};

// Azimuth and polar angle of a block of normals, one per lane.
struct Angles {
    int64_t here;
    Turn azimuth, polar;

    Angles(int64_t first, int64_t count, const float *angles)
        : here(std::min<int64_t>(Lanes<double>::count, count - first)), azimuth(every(angles + 2 * first, here)),
          polar(every(angles + 2 * first + 1, here)) {}

    static V<double> every(const float *from, int64_t here) {
        V<double> found{};
        for (int64_t i = 0; i < here; ++i) found[i] = from[2 * i];
        return found;
    }
};

// Turns angles [count, 2] (azimuth, polar; radians) into unit vectors [count, 3].
void vectors(int64_t count, const float *angles, float *out, int threads) {
    const int n = Lanes<double>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        Angles at(first, count, angles);
        V<double> x = at.polar.sine * at.azimuth.sine, z = at.polar.sine * at.azimuth.cosine;
        for (int64_t i = 0; i < at.here; ++i) {
            float *v = out + 3 * (first + i);
            v[0] = (float)x[i], v[1] = (float)at.polar.cosine[i], v[2] = (float)z[i];
        }
    }
}

// Turns d_vectors [count, 3] into the gradient with respect to the angles, d_angles [count, 2].
void vectors_backward(int64_t count, const float *angles, const float *d_vectors, float *d_angles, int threads) {
    const int n = Lanes<double>::count;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += n) {
        Angles at(first, count, angles);
        V<double> g[3]{};
        for (int64_t i = 0; i < at.here; ++i)
            for (int k = 0; k < 3; ++k) g[k][i] = d_vectors[3 * (first + i) + k];
        V<double> around = at.polar.sine * (g[0] * at.azimuth.cosine - g[2] * at.azimuth.sine);
        V<double> down = at.polar.cosine * (g[0] * at.azimuth.sine + g[2] * at.azimuth.cosine) - at.polar.sine * g[1];
        for (int64_t i = 0; i < at.here; ++i)
            d_angles[2 * (first + i)] = (float)around[i], d_angles[2 * (first + i) + 1] = (float)down[i];
    }
}

}  // namespace

EXPORT void vectors_float(int64_t count, const float *angles, float *out, int threads) {
    vectors(count, angles, out, threads);
}
EXPORT void vectors_backward_float(int64_t count, const float *angles, const float *d_vectors, float *d_angles, int threads) {
    vectors_backward(count, angles, d_vectors, d_angles, threads);
}
FUNCTION(vectors_float)
FUNCTION(vectors_backward_float)
