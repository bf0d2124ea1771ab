// A repeated texture: bilinear in two mipmaps and linear between them.

#pragma once

#include "lanes.h"
#include "layout.h"

namespace {

constexpr int WIDTH = Lanes<float>::count;
typedef V<float> Floats;
typedef I<float> Ints;

inline Floats choose(Ints mask, Floats yes, Floats no) { return choose<float>(mask, yes, no); }

struct Texture {
    int64_t levels;  // 0: there is none
    const float *const *texels;  // [levels], each [height, width, 4]: linear red, green, blue; alpha
    const int64_t *sizes;  // [levels, 2], height and width
};

typedef float Texel __attribute__((vector_size(16), aligned(4)));  // linear red, green, blue; alpha

inline Texel between(float part, Texel from, Texel to) { return from + part * (to - from); }

inline Texel look_up(const Texture &texture, int64_t level, float u, float v) {
    const int64_t high = texture.sizes[2 * level], wide = texture.sizes[2 * level + 1];
    const float x = (u - std::floor(u)) * wide - 0.5f, y = (v - std::floor(v)) * high - 0.5f;
    const int64_t left = (int64_t)std::floor(x), low = (int64_t)std::floor(y);
    const auto row = [&](int64_t r) {
        const Texel *texels = (const Texel *)texture.texels[level] + wide * ((r + high) % high);
        return between(x - left, texels[(left + wide) % wide], texels[(left + 1) % wide]);
    };
    return between(y - low, row(low), row(low + 1));
}

// At u and v, which change by so much from a pixel to the one on its right, and to the one above.
inline Texel sample(const Texture &texture, float u, float v, float u_right, float v_right, float u_up, float v_up) {
    const float high = texture.sizes[0], wide = texture.sizes[1];
    const float texels = std::max(std::hypot(u_right * wide, v_right * high), std::hypot(u_up * wide, v_up * high));
    const float level = std::clamp(std::log2(texels), 0.0f, float(texture.levels - 1)), part = level - std::floor(level);
    const Texel found = look_up(texture, (int64_t)level, u, v);
    return part == 0 ? found : between(part, found, look_up(texture, (int64_t)level + 1, u, v));
}

}  // namespace
