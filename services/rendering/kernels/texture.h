// A repeated sRGB texture: decoded, then bilinear in two mipmaps and linear between them.

#pragma once

#include "lanes.h"
#include "layout.h"

namespace {

constexpr int WIDTH = Lanes<float>::count;
typedef V<float> Floats;
typedef I<float> Ints;

inline Floats choose(Ints mask, Floats yes, Floats no) { return choose<float>(mask, yes, no); }

struct Texture {
    static std::string layout_name() { return "Texture"; }

    int64_t levels;  // 0: there is none
    const uint8_t *const *texels;  // [levels], each [height, width, 4]
    const int64_t *sizes;  // [levels, 2], height and width
};

struct Texel {
    float c[4];  // linear red, green, blue; alpha
};

struct Decoded {
    float of[256];
    Decoded() {
        for (int i = 0; i < 256; ++i) of[i] = i <= 10 ? i / (255 * 12.92) : std::pow((i / 255.0 + 0.055) / 1.055, 2.4);
    }
};
inline const Decoded decoded;

inline float between(float part, float from, float to) { return from + part * (to - from); }

inline Texel look_up(const Texture &texture, int64_t level, float u, float v) {
    const int64_t high = texture.sizes[2 * level], wide = texture.sizes[2 * level + 1];
    const float x = (u - std::floor(u)) * wide - 0.5f, y = (v - std::floor(v)) * high - 0.5f;
    const int64_t left = (int64_t)std::floor(x), low = (int64_t)std::floor(y);
    const int64_t columns[2] = {(left + wide) % wide, (left + 1) % wide}, rows[2] = {(low + high) % high, (low + 1) % high};
    Texel found;
    for (int c = 0; c < 4; ++c) {
        float of_row[2];
        for (int k = 0; k < 2; ++k) {
            const uint8_t *row = texture.texels[level] + 4 * wide * rows[k] + c;
            const uint8_t a = row[4 * columns[0]], b = row[4 * columns[1]];
            of_row[k] = c < 3 ? between(x - left, decoded.of[a], decoded.of[b]) : between(x - left, a, b) / 255;
        }
        found.c[c] = between(y - low, of_row[0], of_row[1]);
    }
    return found;
}

// At u and v, which change by so much from a pixel to the one on its right, and to the one above.
inline Texel sample(const Texture &texture, float u, float v, float u_right, float v_right, float u_up, float v_up) {
    const float high = texture.sizes[0], wide = texture.sizes[1];
    const float texels = std::max(std::hypot(u_right * wide, v_right * high), std::hypot(u_up * wide, v_up * high));
    const float level = std::clamp(std::log2(texels), 0.0f, float(texture.levels - 1)), part = level - std::floor(level);
    Texel found = look_up(texture, (int64_t)level, u, v);
    if (part == 0) return found;
    const Texel next = look_up(texture, (int64_t)level + 1, u, v);
    for (int c = 0; c < 4; ++c) found.c[c] = between(part, found.c[c], next.c[c]);
    return found;
}

}  // namespace
