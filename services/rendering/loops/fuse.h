// Vectors of floats, and the sum of a product: in one rounding where the processor can, as the driver does it there.

#pragma once

#include "lanes.h"

namespace {

constexpr int WIDTH = Lanes<float>::count;
typedef V<float> Floats;
typedef I<float> Ints;

inline Floats choose(Ints mask, Floats yes, Floats no) { return choose<float>(mask, yes, no); }

#ifdef __FMA__
inline float fuse(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
#else
inline float fuse(float a, float b, float c) { return a * b + c; }
#endif

inline Floats fuse(float a, Floats b, Floats c) {
    Floats r;
    for (int i = 0; i < WIDTH; ++i) r[i] = fuse(a, b[i], c[i]);
    return r;
}

inline float between(float part, float from, float to) { return fuse(part, to - from, from); }

}  // namespace
