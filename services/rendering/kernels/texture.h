// A repeated sRGB texture as the driver looks it up: its own mipmaps and its own curve, bilinear in two levels.

#pragma once

#include "fuse.h"
#include "layout.h"

namespace {

struct Texture {
    static std::string layout_name() { return "Texture"; }

    int64_t levels;  // 0: there is none
    const uint8_t *const *texels;  // [levels], each [height, width, 4]
    const int64_t *sizes;  // [levels, 2], height and width
};

struct Texel {
    float c[4];  // linear red, green, blue; alpha
};

struct Curve {
    float of[256];
    Curve() {
        for (int i = 0; i < 256; ++i) {
            const float x = i, x2 = x * x;
            const float even = fuse(x2, 0.6935f / (255.0f * 255.0f), 0.0023f);
            const float odd = fuse(x2, 0.3012f / (255.0f * 255.0f * 255.0f), 0.0030f / 255.0f);
            of[i] = i <= 15 ? x * (1.0f / (12.6f * 255.0f)) : fuse(odd, x, even);
        }
    }
};
inline const Curve curve;

// The two texels around a coordinate, and how far it is from the first to the second.
struct Around {
    int64_t first, second;
    float part;

    Around(float at, int64_t size, bool power_of_two) {
        if (power_of_two) {
            const float scaled = at * size - 0.5f, low = std::floor(scaled);
            first = int64_t(low) & (size - 1), second = (int64_t(low) + 1) & (size - 1), part = scaled - low;
        } else {
            const float scaled = (at - std::floor(at)) * size - 0.5f, low = std::floor(scaled);
            first = scaled < 0 ? size - 1 : int64_t(low), part = scaled - low;
            second = first != size - 1 ? first + 1 : 0;
        }
    }
};

inline bool is_power_of_two(int64_t n) { return (n & (n - 1)) == 0; }

inline Texel look_up(const Texture &texture, int64_t level, float u, float v) {
    const int64_t high = texture.sizes[2 * level], wide = texture.sizes[2 * level + 1];
    const Around x(u, wide, is_power_of_two(texture.sizes[1])), y(v, high, is_power_of_two(texture.sizes[0]));
    const uint8_t *rows[2] = {texture.texels[level] + 4 * wide * y.first, texture.texels[level] + 4 * wide * y.second};
    Texel found;
    for (int c = 0; c < 4; ++c) {
        float of_row[2];
        for (int k = 0; k < 2; ++k) {
            const uint8_t a = rows[k][4 * x.first + c], b = rows[k][4 * x.second + c];
            of_row[k] = c < 3 ? between(x.part, curve.of[a], curve.of[b])
                              : between(x.part, a * float(1.0 / 255), b * float(1.0 / 255));
        }
        found.c[c] = between(y.part, of_row[0], of_row[1]);
    }
    return found;
}

// Where a pixel sees the texture, in a block of 2 x 2 pixels that does so at `us` and `vs`.
inline Texel sample(const Texture &texture, const float *us, const float *vs, int pixel) {
    const float high = texture.sizes[0], wide = texture.sizes[1];
    auto squared_length = [&](int k) {
        const float x = (us[k] - us[0]) * wide, y = (vs[k] - vs[0]) * high;
        return x * x + y * y;
    };
    const float square = std::max(squared_length(1), squared_length(2));  // of texels to a pixel
    int32_t bits;
    std::memcpy(&bits, &square, sizeof bits);
    const float exponent = ((bits >> 23) & 255) - 128;
    bits = (bits & 0x7fffff) | 0x3f800000;
    float mantissa;
    std::memcpy(&mantissa, &bits, sizeof bits);
    const float detail = (exponent + mantissa) * 0.5f;  // its logarithm, linear between powers of two
    int64_t level = int64_t(std::floor(detail)), last = texture.levels - 1;
    float part = detail - std::floor(detail);
    if (level < 0 || level >= last) level = level < 0 ? 0 : last, part = 0;
    Texel found = look_up(texture, level, us[pixel], vs[pixel]);
    if (part > 0) {
        const Texel next = look_up(texture, level + 1, us[pixel], vs[pixel]);
        for (int c = 0; c < 4; ++c) found.c[c] = between(part, found.c[c], next.c[c]);
    }
    return found;
}

}  // namespace
