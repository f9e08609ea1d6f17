// The film: the sum of samples into blocks of pixels.
#pragma once

#include <cstring>
#include <stdexcept>
#include <vector>

#include "film_places.h"

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

    // Most are of three components and alpha.
    static constexpr int Usual = 4;
    typedef double UsualValues __attribute__((vector_size(Usual * sizeof(double))));
    bool is_usual() const { return values == Usual && moments == 0; }

    // Adds a sample.
    template <class F>
    void splat(const FilmPlace<F> &place, const double *value) {
        if (is_usual()) return for_reached(place, [&](double *p, double w) { add_sample(p, w, value, Usual, 0); });
        for_reached(place, [&](double *p, double w) { add_sample(p, w, value, values, moments); });
    }

    // The same for lanes begin to end of a usual film, which are a run of samples: the same sums. All values are
    // finite, those that a sample does not reach getting 0 of it.
    template <class F>
    void splat_run(const SplatAxes<F> &axes, int begin, int end, const UsualValues *value) {
        for_run(axes, begin, end, [&](double *p, const double *w) {
            UsualValues sum;
            std::memcpy(&sum, p, sizeof(sum));
            double total = p[Usual];
            for (int i = begin; i < end; ++i) sum += w[i] * value[i], total += w[i];
            std::memcpy(p, &sum, sizeof(sum));
            p[Usual] = total;
        });
    }

    // Adds the weights alone of a sample that counts `times` times.
    template <class F>
    void add_weight(const FilmPlace<F> &place, double times) {
        for_reached(place, [&](double *p, double w) { p[values] += w * times; });
    }
    // ... of a run of samples that count once: the same sums.
    template <class F>
    void add_weights(const SplatAxes<F> &axes, int begin, int end) {
        for_run(axes, begin, end, [&](double *p, const double *w) {
            double total = p[values];
            for (int i = begin; i < end; ++i) total += w[i];
            p[values] = total;
        });
    }

    // Adds samples k .. end of one pixel with the box filter, whose values are in columns.
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

    // The transposed of `splat`: what a sample gets of the numbers in the block.
    template <class F>
    void collect(const FilmPlace<F> &place, double *to) const {
        auto *block = const_cast<FilmBlock *>(this);
        if (values == 3 && moments == 0) {
            double sum[4] = {};  // as a vector, in which the sum of weights does not matter
            block->for_reached(place, [&](const double *p, double w) {
                for (int c = 0; c < 4; ++c) sum[c] += w * p[c];
            });
            std::copy_n(sum, 3, to);
            return;
        }
        for (int c = 0; c < values; ++c) to[c] = 0;
        block->for_reached(place, [&](const double *p, double w) {
            for (int c = 0; c < values; ++c) to[c] += w * p[c];
        });
    }

private:
    // visit(sums of a pixel, weights of all lanes) of what lanes begin to end reach. Pixel by pixel sums stay in
    // registers, where those of single samples wait for memory that was written just before.
    template <class F, class Visit>
    void for_run(const SplatAxes<F> &axes, int begin, int end, Visit &&visit) {
        constexpr int W = Lanes<F>::Width;
        const RunWeights<F> x(axes.x, begin, end), y(axes.y, begin, end);
        const FilterSpan h(x.first, x.n, rect.x0, rect.x1), v(y.first, y.n, rect.y0, rect.y1);
        if (h.empty()) return;
        for (int j = v.begin; j < v.end; ++j) {
            double *p = at(y.first + j, x.first + h.begin);
            for (int k = h.begin; k < h.end; ++k, p += channels()) {
                alignas(64) double w[W];
                for (int i = 0; i < W; ++i) w[i] = double(y.weight[j][i]) * double(x.weight[k][i]);
                visit(p, w);
            }
        }
    }

    // visit(sums of a pixel, weight)
    template <class F, class Visit>
    void for_reached(const FilmPlace<F> &place, Visit &&visit) {
        if (!place.axes) {
            if (rect.contains(place.row, place.column)) visit(at(place.row, place.column), 1.0);
            return;
        }
        const SplatAxis<F> &x = place.axes->x, &y = place.axes->y;
        const int lane = place.lane, x0 = x.first[lane], y0 = y.first[lane];
        const FilterSpan h(x0, x.n, rect.x0, rect.x1), v(y0, y.n, rect.y0, rect.y1);
        if (h.empty()) return;
        for (int j = v.begin; j < v.end; ++j) {
            const double wy = double(y.weight[j][lane]);
            if (wy == 0) continue;
            double *p = at(y0 + j, x0 + h.begin);
            for (int k = h.begin; k < h.end; ++k, p += channels()) {
                const double wx = double(x.weight[k][lane]);
                if (wx != 0) visit(p, wy * wx);
            }
        }
    }
};

}  // namespace tr
