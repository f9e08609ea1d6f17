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

// Variance of the weighted mean sum w x / sum w of independent samples, from the sums of w x, w, w^2 x^2, w^2 x and
// w^2: the linearised ratio estimator sum w^2 (x - mean)^2 / (sum w)^2, times n / (n - 1) with the effective number of
// samples n = (sum w)^2 / sum w^2. With equal weights that is the sample variance over the number of samples. Infinite
// where nothing is known of it: with one sample.
TR_HD inline double variance_of_mean(double wx, double w, double w2x2, double w2x, double w2) {
    if (w == 0 || w2 == 0) return double(INFINITY);
    double mean = wx / w, n = w * w / w2;
    if (n < 1 + 1e-9) return double(INFINITY);
    double sum = w2x2 - 2 * mean * w2x + mean * mean * w2;
    return (sum > 0 ? sum : 0.0) / (w * w) * (n / (n - 1));
}

// Where the results of a film are, one of `numbers` for every pixel: `image` and, if not null, `alpha`, `variance`,
// that of the image's numbers, and `second_moment`, the mean of squared samples.
template <class S>
struct ImagePlaces {
    S *image, *alpha = nullptr, *variance = nullptr, *second_moment = nullptr;

    // Result i, from the sums of its pixel: of its numbers, alpha and `moments` of the former.
    TR_HD void write(size_t i, const double *p, int numbers, int moments) const {
        const double *q = p + numbers + 2;
        const double weight = p[numbers + 1], inverse = weight != 0 ? 1 / weight : 0;
        for (int c = 0; c < numbers; ++c) image[i * size_t(numbers) + size_t(c)] = S(p[c] * inverse);
        if (alpha) alpha[i] = S(p[numbers] * inverse);
        for (int c = 0; c < moments; ++c) {
            const size_t at = i * size_t(numbers) + size_t(c);
            if (second_moment) second_moment[at] = S(q[2 * numbers + c] * inverse);
            if (variance) variance[at] = S(variance_of_mean(p[c], weight, q[c], q[numbers + c], q[3 * numbers]));
        }
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(image), visit(alpha), visit(variance), visit(second_moment);
    }
};

}  // namespace tr
