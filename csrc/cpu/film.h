// The film: the sum of samples into blocks of pixels.
#pragma once

#include <stdexcept>
#include <vector>

#include "core/film/filter.h"
#include "core/film/sums.h"

namespace tr {

inline Rect intersect(const Rect &a, const Rect &b) {
    return {std::max(a.y0, b.y0), std::max(a.x0, b.x0), std::min(a.y1, b.y1), std::min(a.x1, b.x1)};
}

// Sums of all results of a film, of so many samples a pixel, between calls that render some of its samples each.
struct FilmSums {
    std::vector<double> sum;
    int64_t spp = 0;

    // Of n numbers in all; `more` samples follow.
    void begin(size_t n, int64_t more) {
        if (sum.empty()) sum.assign(n, 0.0);
        if (sum.size() != n) throw std::invalid_argument("sums: those of another film");
        spp += more;
    }
    // Adds numbers to those that begin at `first`, and returns these.
    const double *add(size_t first, const double *numbers, int n) {
        for (int c = 0; c < n; ++c) sum[first + size_t(c)] += numbers[c];
        return &sum[first];
    }
};

// Sums over a rectangle: of the channels' values times filter weights and, last, of the weights themselves. With
// `moments` also of squares x^2 of values with weights w: w^2 x^2, w^2 x, w x^2 and w^2 (see variance_of_mean).
struct FilmBlock {
    Rect rect{0, 0, 0, 0};
    int values = 0, moments = 0;  // channels of values; how many of them, from the first, have moments
    std::vector<double> sum;

    static int channels(int values, int moments) { return values + 1 + (moments ? 3 * moments + 1 : 0); }
    int channels() const { return channels(values, moments); }

    void reset(const Rect &r, int n_values, int n_moments = 0) {
        rect = r;
        values = n_values, moments = n_moments;
        sum.assign(size_t(std::max(0, r.height())) * size_t(std::max(0, r.width())) * size_t(channels()), 0.0);
    }
    double *at(int y, int x) {
        return &sum[(size_t(y - rect.y0) * size_t(rect.width()) + size_t(x - rect.x0)) * size_t(channels())];
    }
    const double *at(int y, int x) const { return const_cast<FilmBlock *>(this)->at(y, x); }

    // Adds a sample of pixel (row, column), at film position (y, x) in pixels. (The position itself may have been
    // rounded into the next pixel.)
    void splat(const Filter &filter, int row, int column, double y, double x, const double *value) {
        for_reached(filter, row, column, y, x, [&](double *p, double w) { add_sample(p, w, value, values, moments); });
    }

    // The same for samples k .. end of one pixel with the box filter, whose values are in columns.
    template <class S>
    void splat_pixel(int row, int column, size_t k, size_t end, S *const *value) {
        if (!rect.contains(row, column)) return;
        double *p = at(row, column), *q = p + values + 1;
        p[values] += double(end - k);
        for (int c = 0; c < values; ++c) {
            double total = p[c];
            for (size_t i = k; i < end; ++i) total += double(value[c][i]);
            p[c] = total;
        }
        for (int c = 0; c < moments; ++c)
            for (size_t i = k; i < end; ++i) {
                double v = double(value[c][i]);
                q[c] += v * v;
                q[moments + c] += v;
                q[2 * moments + c] += v * v;
            }
        if (moments) q[3 * moments] += double(end - k);
    }

    // Adds the weights alone of a sample that counts `times` times.
    void add_weight(const Filter &filter, int row, int column, double y, double x, double times) {
        for_reached(filter, row, column, y, x, [&](double *p, double w) { p[values] += w * times; });
    }

    // The transposed of `splat`: what a sample gets of the numbers in the block.
    void collect(const Filter &filter, int row, int column, double y, double x, double *to) const {
        for (int c = 0; c < values; ++c) to[c] = 0;
        const_cast<FilmBlock *>(this)->for_reached(filter, row, column, y, x, [&](const double *p, double w) {
            for (int c = 0; c < values; ++c) to[c] += w * p[c];
        });
    }

private:
    template <class Visit>
    void for_reached(const Filter &filter, int row, int column, double y, double x, Visit &&visit) {
        int reach = filter.reach();
        if (reach == 0) {
            if (rect.contains(row, column)) visit(at(row, column), 1.0);
            return;
        }
        double wx[2 * MaxReach + 1];
        reach = std::min(reach, MaxReach);
        int x0 = std::max(column - reach, rect.x0), x1 = std::min(column + reach, rect.x1 - 1);
        for (int i = x0; i <= x1; ++i) wx[i - x0] = filter(i + 0.5 - x);
        for (int j = std::max(row - reach, rect.y0); j <= std::min(row + reach, rect.y1 - 1); ++j) {
            double wy = filter(j + 0.5 - y);
            if (wy == 0) continue;
            for (int i = x0; i <= x1; ++i)
                if (wx[i - x0] != 0) visit(at(j, i), wy * wx[i - x0]);
        }
    }
};

}  // namespace tr
