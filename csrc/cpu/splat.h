// What is splatted anywhere on the film: sums of values times filter weights, and the transposed of it. A thread works
// with sums of its own.
#pragma once

#include <cstring>
#include <vector>

#include "core/color/spectrum.h"
#include "film_places.h"

namespace tr {

// Numbers of type T, those of a spectrum a pixel, of a rectangle of the film. They are kept in vectors, of which a
// splat needs many and the compiler finds none by itself.
template <class T>
class SplatFilm {
public:
    static constexpr int Stride = 4;  // a power of two; at least the components of a spectrum
    typedef T Vector __attribute__((vector_size(Stride * sizeof(T))));

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

    // Adds `value` at lane i of two axes.
    template <class F>
    void splat(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, const Vector &value) {
        for_columns(x, y, i, [&](auto columns, int j, FilterSpan rows, T *to) {
            const auto across = columns.repeated(value) * columns.spread(x.weight, j, i);
            for (int k = rows.begin; k < rows.end; ++k, to += row_stride())
                columns.put(to, columns.get(to) + across * T(y.weight[k][i]));
        });
    }
    // The derivative of it when the place moves.
    template <class F>
    void splat_motion(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, T dx, T dy, const Vector &value) {
        for_columns(x, y, i, [&](auto columns, int j, FilterSpan rows, T *to) {
            const auto all = columns.repeated(value);
            const auto by_x = all * columns.spread(x.slope, j, i) * dx,
                       by_y = all * columns.spread(x.weight, j, i) * dy;
            for (int k = rows.begin; k < rows.end; ++k, to += row_stride())
                columns.put(to, columns.get(to) + (by_x * T(y.weight[k][i]) + by_y * T(y.slope[k][i])));
        });
    }
    // The transposed: sums of weights times numbers of the film, and their derivatives by the place.
    template <class F>
    void collect(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, Vector &sum, Vector &by_x, Vector &by_y) const {
        sum = by_x = by_y = Vector{};
        const_cast<SplatFilm *>(this)->for_columns(x, y, i, [&](auto columns, int j, FilterSpan rows, const T *from) {
            typename decltype(columns)::Values down{}, slopes_down{};
            for (int k = rows.begin; k < rows.end; ++k, from += row_stride()) {
                const auto value = columns.get(from);
                down += value * T(y.weight[k][i]), slopes_down += value * T(y.slope[k][i]);
            }
            const auto across = columns.spread(x.weight, j, i);
            sum += columns.total(down * across);
            by_x += columns.total(down * columns.spread(x.slope, j, i));
            by_y += columns.total(slopes_down * across);
        });
    }

private:
    struct Texel {  // an attribute of its member's type would be lost in a template's argument
        Vector v;
    };
    // N pixels beside each other as one vector, which has to fit a register: of longer ones GCC keeps sums in memory.
    template <int N>
    struct Columns {
        static_assert(N == 1 || N == 2);
        typedef T Values __attribute__((vector_size(N * Stride * sizeof(T))));
        static Values get(const T *from) {
            Values r;
            std::memcpy(&r, from, sizeof(r));
            return r;
        }
        static void put(T *to, const Values &x) { std::memcpy(to, &x, sizeof(x)); }
        static Values repeated(const Vector &x) {
            if constexpr (N == 1)
                return x;
            else
                return Values{x[0], x[1], x[2], x[3], x[0], x[1], x[2], x[3]};
        }
        template <class S, int W>
        static Values spread(const S (*weight)[W], int j, int i) {
            if constexpr (N == 1) {
                return Values{} + T(weight[j][i]);
            } else {
                const T a = T(weight[j][i]), b = T(weight[j + 1][i]);
                return Values{a, a, a, a, b, b, b, b};
            }
        }
        static Vector total(const Values &x) {
            if constexpr (N == 1) {
                return x;
            } else {
                Vector half[2];
                std::memcpy(half, &x, sizeof(x));
                return half[0] + half[1];
            }
        }
    };
#if defined(__AVX__)
    static constexpr int Beside = sizeof(T) == 4 ? 2 : 1;
#else
    static constexpr int Beside = 1;
#endif
    ptrdiff_t row_stride() const { return Stride * ptrdiff_t(rect_.width()); }
    // The columns of the film that a place reaches, some at once: visit(columns, number of the first in the filter,
    // rows, pointer to its numbers in the first row).
    template <class F, class Visit>
    void for_columns(const SplatAxis<F> &x, const SplatAxis<F> &y, int i, Visit &&visit) {
        const FilterSpan h(x.first[i], x.n, rect_.x0, rect_.x1), v(y.first[i], y.n, rect_.y0, rect_.y1);
        if (v.empty() || h.empty()) return;
        T *to = reinterpret_cast<T *>(row_at(y.first[i] + v.begin, x.first[i] + h.begin));
        int j = h.begin;
        // All of a filter of radius 2, such as the usual Gaussian: loops over rows are unrolled.
        const FilterSpan usual(0, 4, 0, 4);
        if (h == usual && v == usual) {
            for (; j < 4; j += Beside, to += Beside * Stride) visit(Columns<Beside>{}, j, usual, to);
            return;
        }
        for (; j + Beside <= h.end; j += Beside, to += Beside * Stride) visit(Columns<Beside>{}, j, v, to);
        for (; j < h.end; ++j, to += Stride) visit(Columns<1>{}, j, v, to);
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
