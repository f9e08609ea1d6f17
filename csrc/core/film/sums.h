// Sums of samples over a film, a pixel: host and device have the same.
#pragma once

#include "../math/config.h"

namespace tr {

struct Rect {
    int y0, x0, y1, x1;  // half open
    TR_HD int height() const { return y1 - y0; }
    TR_HD int width() const { return x1 - x0; }
    bool contains(int y, int x) const { return y >= y0 && y < y1 && x >= x0 && x < x1; }
};

// Pixels are numbered alike whatever is rendered of a film, those outside of it included.
TR_HD inline uint32_t pixel_number(int y, int x) { return (uint32_t(y + 32768) << 16) + uint32_t(x + 32768); }

// Pixels on each side of its own that a sample's weights are computed for.
constexpr int MaxReach = 64;

// Adds a sample of weight w to the sums of a pixel: of values, weights and moments, see FilmBlock.
TR_INLINE void add_sample(double *p, double w, const double *value, int values, int moments) {
    for (int c = 0; c < values; ++c) p[c] += w * value[c];
    p[values] += w;
    if (moments == 0) return;
    // no product is shared, so that a compiler that fuses products and sums does so in every copy of the loop
    double *q = p + values + 1, w2 = w * w;
    for (int c = 0; c < moments; ++c) q[c] += w2 * (value[c] * value[c]);
    for (int c = 0; c < moments; ++c) q[moments + c] += w2 * value[c];
    for (int c = 0; c < moments; ++c) q[2 * moments + c] += w * (value[c] * value[c]);
    q[3 * moments] += w2;
}

}  // namespace tr
