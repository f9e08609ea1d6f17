// What is splatted anywhere on the film: sums of values times filter weights, and the transposed of it. A thread works
// with sums of its own.
#pragma once

#include <vector>

#include "film.h"

namespace tr {

// Weights of the pixels around places on the film, for W of them at once: pixel `first[i] + k` along an axis has
// weight[k][i] and slope[k][i], the derivative of the weight by the place.
template <class F>
struct SplatAxis {
    using S = ScalarOf<F>;
    static constexpr int W = Lanes<F>::Width, Most = 2 * 64 + 1;
    int n;
    alignas(64) int32_t first[W];
    alignas(64) S weight[Most][W], slope[Most][W];

    SplatAxis() {}  // the tables are large

    void set(const Filter &filter, const F &x, bool slopes) {
        int reach = std::min(filter.reach(), (Most - 1) / 2);
        n = 2 * reach + 1;
        F base = floor(x);
        F from = base + F(S(0.5 - reach)) - x;
        for (int k = 0; k < n; ++k) {
            F offset = from + F(S(k));
            store(&weight[k][0], filter.weight(offset));
            if (slopes) store(&slope[k][0], -filter.slope(offset));
        }
        alignas(64) S f[W];
        store(&f[0], base);
        for (int i = 0; i < W; ++i)  // places far away stay far away
            first[i] = int32_t(std::min(std::max(f[i], S(-1e9)), S(1e9))) - reach;
    }
};

// Numbers of type T, C a pixel, of a rectangle of the film.
template <class T, int C>
class SplatFilm {
public:
    static constexpr int Stride = C == 3 ? 4 : C;  // a power of two, for vectors

    explicit SplatFilm(const Rect &rect)
        : rect_(rect), sum_(size_t(std::max(0, rect.height())) * size_t(std::max(0, rect.width())) * Stride, T(0)) {}

    T *at(int y, int x) { return &sum_[offset(y, x)]; }
    const T *at(int y, int x) const { return &sum_[offset(y, x)]; }
    const Rect &rect() const { return rect_; }
    void add(const SplatFilm &other) {
        for (size_t i = 0; i < sum_.size(); ++i) sum_[i] += other.sum_[i];
    }

    // Adds value[c], a number a lane, at lane i of two axes.
    template <class F>
    void splat(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, const T (&value)[Stride]) {
        Span h = reached(x.first[i], x.n, rect_.x0, rect_.x1), v = reached(y.first[i], y.n, rect_.y0, rect_.y1);
        for (int k = v.begin; k < v.end; ++k) {
            T *row = at(y.first[i] + k, x.first[i] + h.begin);
            T by[Stride];
            for (int c = 0; c < Stride; ++c) by[c] = value[c] * T(y.weight[k][i]);
            for (int j = h.begin; j < h.end; ++j, row += Stride) {
                T w = T(x.weight[j][i]);
                for (int c = 0; c < Stride; ++c) row[c] += w * by[c];
            }
        }
    }
    // The derivative of it when the place moves.
    template <class F>
    void splat_motion(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, T dx, T dy, const T (&value)[Stride]) {
        Span h = reached(x.first[i], x.n, rect_.x0, rect_.x1), v = reached(y.first[i], y.n, rect_.y0, rect_.y1);
        for (int k = v.begin; k < v.end; ++k)
            for (int j = h.begin; j < h.end; ++j) {
                T w = T(x.slope[j][i]) * T(y.weight[k][i]) * dx + T(x.weight[j][i]) * T(y.slope[k][i]) * dy;
                T *to = at(y.first[i] + k, x.first[i] + j);
                for (int c = 0; c < Stride; ++c) to[c] += w * value[c];
            }
    }
    // The transposed: sums of weights times numbers of the film, and their derivatives by the place.
    template <class F>
    void collect(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, T (&sum)[Stride], T (&by_x)[Stride],
                 T (&by_y)[Stride]) const {
        Span h = reached(x.first[i], x.n, rect_.x0, rect_.x1), v = reached(y.first[i], y.n, rect_.y0, rect_.y1);
        for (int c = 0; c < Stride; ++c) sum[c] = by_x[c] = by_y[c] = T(0);
        for (int k = v.begin; k < v.end; ++k) {
            const T *row = at(y.first[i] + k, x.first[i] + h.begin);
            T value[Stride] = {}, slope[Stride] = {};
            for (int j = h.begin; j < h.end; ++j, row += Stride) {
                T w = T(x.weight[j][i]), s = T(x.slope[j][i]);
                for (int c = 0; c < Stride; ++c) value[c] += w * row[c], slope[c] += s * row[c];
            }
            T w = T(y.weight[k][i]), s = T(y.slope[k][i]);
            for (int c = 0; c < Stride; ++c) sum[c] += w * value[c], by_x[c] += w * slope[c], by_y[c] += s * value[c];
        }
    }

private:
    struct Span {
        int begin, end;
    };
    static Span reached(int first, int n, int low, int high) {
        int begin = std::max(0, low - first);
        return {begin, std::max(begin, std::min(n, high - first))};
    }
    size_t offset(int y, int x) const {
        return (size_t(y - rect_.y0) * size_t(rect_.width()) + size_t(x - rect_.x0)) * Stride;
    }

    Rect rect_;
    std::vector<T> sum_;
};

}  // namespace tr
