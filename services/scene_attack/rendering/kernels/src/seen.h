// The visibility of a direction from a block of pixels, a fixed factor of the shading sum in scenes with shadows.

#pragma once

#include "lanes.h"

namespace {

// `visibility` [directions, count] in units of 1/255; lanes beyond the last pixel see nothing.
template <class T> inline V<T> seen(const uint8_t *visibility, int64_t d, int64_t count, int64_t first) {
    const int here = (int)std::min<int64_t>(Lanes<T>::count, count - first);
    const uint8_t *row = visibility + d * count + first;
    V<T> share{};
    if (here == Lanes<T>::count)
        for (int i = 0; i < Lanes<T>::count; ++i) share[i] = row[i];
    else
        for (int i = 0; i < here; ++i) share[i] = row[i];
    return share * (T(1) / T(255));
}

}  // namespace

// Calls f<T, channels, shadows> for the scene `s`. Without shadows the code, and so its bits, has no such factor.
#define CHOOSE(f, T, s, ...)                                                                                           \
    (s).visibility ? ((s).channels == 1 ? f<T, 1, true>(s, __VA_ARGS__) : f<T, 3, true>(s, __VA_ARGS__))               \
                   : ((s).channels == 1 ? f<T, 1, false>(s, __VA_ARGS__) : f<T, 3, false>(s, __VA_ARGS__))
