// Vectors of floats, and the sum of a product: in one rounding where the processor can, as the driver does it there.

#pragma once

#ifdef __AVX512DQ__
#include <immintrin.h>
#endif

#include "lanes.h"

namespace {

constexpr int WIDTH = Lanes<float>::count;
typedef V<float> Floats;
typedef I<float> Ints;

inline Floats choose(Ints mask, Floats yes, Floats no) { return choose<float>(mask, yes, no); }

// A bit for each lane of a mask.
inline uint32_t bits_of(Ints mask) {
#ifdef __AVX512DQ__
    return _mm512_movepi32_mask((__m512i)mask);
#else
    uint32_t bits = 0;
    const Ints one = mask & Ints{1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768};
    for (int i = 0; i < WIDTH; ++i) bits |= one[i];
    return bits;
#endif
}

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
