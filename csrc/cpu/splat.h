// What is splatted anywhere on the film: sums of values times filter weights, and the transposed of it. A thread works
// with sums of its own.
#pragma once

#include <cstring>
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
            F by_place(0);
            store(&weight[k][0], slopes ? filter.weight(offset, by_place) : filter.weight(offset));
            if (slopes) store(&slope[k][0], -by_place);
        }
        alignas(64) S f[W];
        store(&f[0], base);
        for (int i = 0; i < W; ++i)  // places far away stay far away
            first[i] = int32_t(std::min(std::max(f[i], S(-1e9)), S(1e9))) - reach;
    }
};

// Both axes. `for_places` visits n places: visit(k, i), their weights being in lane i.
template <class F>
struct SplatAxes {
    using S = ScalarOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);
    SplatAxis<F> x, y;

    template <class Visit>
    void for_places(const Filter &filter, const S *xs, const S *ys, size_t n, bool slopes, Visit &&visit) {
        for (size_t k = 0; k < n; k += W) {
            const size_t lanes = std::min(W, n - k);
            alignas(64) S at_x[W] = {}, at_y[W] = {};
            std::copy_n(xs + k, lanes, at_x), std::copy_n(ys + k, lanes, at_y);
            x.set(filter, load<F>(at_x), slopes), y.set(filter, load<F>(at_y), slopes);
            for (size_t i = 0; i < lanes; ++i) visit(k + i, int(i));
        }
    }
};

// Numbers of type T, those of a spectrum a pixel, of a rectangle of the film. They are kept in vectors, of which a
// splat needs many and the compiler finds none by itself.
template <class T>
class SplatFilm {
public:
    static constexpr int Stride = 4;  // a power of two; at least the components of a spectrum
    typedef T Vector __attribute__((vector_size(Stride * sizeof(T))));
    typedef T Four __attribute__((vector_size(4 * Stride * sizeof(T))));  // of them

    explicit SplatFilm(const Rect &rect)
        : rect_(rect), sum_(size_t(std::max(0, rect.height())) * size_t(std::max(0, rect.width())), Texel{}) {}

    Vector &at(int y, int x) { return sum_[offset(y, x)].v; }
    const Vector &at(int y, int x) const { return sum_[offset(y, x)].v; }
    template <class Other>
    void add(const SplatFilm<Other> &other) {
        for (size_t i = 0; i < sum_.size(); ++i)
            for (int c = 0; c < SpectrumSize; ++c) sum_[i].v[c] += T(other.number(i)[c]);
    }
    const Vector &number(size_t i) const { return sum_[i].v; }
    size_t size() const { return sum_.size(); }
    const T *data() const { return reinterpret_cast<const T *>(sum_.data()); }  // (size, Stride)

    // Adds `value` at lane i of two axes. Most of light tracing's time on the film goes here, hence four pixels at
    // once.
    template <class F>
    void splat(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, const Vector &value) {
        Span h = reached(x.first[i], x.n, rect_.x0, rect_.x1), v = reached(y.first[i], y.n, rect_.y0, rect_.y1);
        if (v.begin == v.end) return;
        int j = h.begin;
        const T a = value[0], b = value[1], c = value[2], d = value[3];
        const Four four{a, b, c, d, a, b, c, d, a, b, c, d, a, b, c, d};
        for (; j + 4 <= h.end; j += 4) {
            const T w0 = x.weight[j][i], w1 = x.weight[j + 1][i], w2 = x.weight[j + 2][i], w3 = x.weight[j + 3][i];
            const Four weight{w0, w0, w0, w0, w1, w1, w1, w1, w2, w2, w2, w2, w3, w3, w3, w3};
            T *to = reinterpret_cast<T *>(row_at(y.first[i] + v.begin, x.first[i] + j));
            for (int k = v.begin; k < v.end; ++k, to += Stride * ptrdiff_t(rect_.width())) {
                Four sum;
                std::memcpy(&sum, to, sizeof(sum));
                sum += four * T(y.weight[k][i]) * weight;
                std::memcpy(to, &sum, sizeof(sum));
            }
        }
        for (; j < h.end; ++j) {
            const T weight = x.weight[j][i];
            Texel *to = row_at(y.first[i] + v.begin, x.first[i] + j);
            for (int k = v.begin; k < v.end; ++k, to += rect_.width()) to->v += value * T(y.weight[k][i]) * weight;
        }
    }
    // The derivative of it when the place moves.
    template <class F>
    void splat_motion(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, T dx, T dy, const Vector &value) {
        Span h = reached(x.first[i], x.n, rect_.x0, rect_.x1), v = reached(y.first[i], y.n, rect_.y0, rect_.y1);
        for (int k = v.begin; k < v.end; ++k) {
            Texel *row = row_at(y.first[i] + k, x.first[i]);
            for (int j = h.begin; j < h.end; ++j)
                row[j].v +=
                    value * (T(x.slope[j][i]) * T(y.weight[k][i]) * dx + T(x.weight[j][i]) * T(y.slope[k][i]) * dy);
        }
    }
    // The transposed: sums of weights times numbers of the film, and their derivatives by the place.
    template <class F>
    void collect(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, Vector &sum, Vector &by_x, Vector &by_y) const {
        Span h = reached(x.first[i], x.n, rect_.x0, rect_.x1), v = reached(y.first[i], y.n, rect_.y0, rect_.y1);
        sum = by_x = by_y = Vector{};
        if (v.begin == v.end) return;
        Vector all{}, all_x{}, all_y{};
        Vector across[SplatAxis<F>::Most], slopes[SplatAxis<F>::Most];  // those of the row, in every component
        for (int j = h.begin; j < h.end; ++j)
            across[j] = Vector{} + T(x.weight[j][i]), slopes[j] = Vector{} + T(x.slope[j][i]);
        const Texel *row = const_cast<SplatFilm *>(this)->row_at(y.first[i] + v.begin, x.first[i]);
        for (int k = v.begin; k < v.end; ++k, row += rect_.width()) {
            Vector value{}, slope{};
            for (int j = h.begin; j < h.end; ++j) value += row[j].v * across[j], slope += row[j].v * slopes[j];
            T w = T(y.weight[k][i]);
            all += value * w, all_x += slope * w, all_y += value * T(y.slope[k][i]);
        }
        sum = all, by_x = all_x, by_y = all_y;
    }

private:
    struct Texel {  // an attribute of its member's type would be lost in a template's argument
        Vector v;
    };
    struct Span {
        int begin, end;
    };
    static Span reached(int first, int n, int low, int high) {
        int begin = std::max(0, low - first);
        return {begin, std::max(begin, std::min(n, high - first))};
    }
    // Column x of a row; it may lie beside the film, where nothing is touched.
    Texel *row_at(int y, int x) {
        return sum_.data() + (ptrdiff_t(y - rect_.y0) * rect_.width() + (ptrdiff_t(x) - rect_.x0));
    }
    size_t offset(int y, int x) const { return size_t(y - rect_.y0) * size_t(rect_.width()) + size_t(x - rect_.x0); }

    Rect rect_;
    std::vector<Texel> sum_;
};

}  // namespace tr
