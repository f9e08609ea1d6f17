// Colours as spectra: the coefficients of sigmoids that have them, by a table. What torchrender/spectrum/upsampling.py
// says of them, and coefficient_table.py makes the table.
#pragma once

#include "../math/dual.h"
#include "../math/rows.h"
#include "spectral.h"

namespace tr {

// By the largest channel, its value, and the ratios of the channels after it to it.
template <class S>
struct SigmoidTable {
    static constexpr int Bins = 1024;
    const S *rows;            // (3, size, size, size, 4): by channel, value, second and first ratio; the last is room
    const S *nodes[2];        // (size,) of values and of ratios, from 0 to 1
    const int32_t *cells[2];  // (Bins + 1,) the cells among them of Bins + 1 equally spaced numbers
    int32_t size;
};

namespace detail {

// The derivative is shared among those that are equal.
template <class F>
TR_INLINE F largest(const F (&x)[3]) {
    return max(max(x[0], x[1]), x[2]);
}
template <class F, int N>
TR_INLINE Dual<F, N> largest(const Dual<F, N> (&x)[3]) {
    Dual<F, N> r(max(max(x[0].v, x[1].v), x[2].v));
    F share[3], sum(0);
    for (int k = 0; k < 3; ++k) share[k] = select(mask<F>(x[k].v == r.v), F(1), F(0)), sum = sum + share[k];
    for (int i = 0; i < N; ++i)
        r.d[i] = (x[0].d[i] * share[0] + x[1].d[i] * share[1] + x[2].d[i] * share[2]) * (F(1) / sum);
    return r;
}

// The cell of a number among the nodes of an axis, and how far it is through it.
template <class F, class T, class S>
TR_INLINE UIntOf<F> place_in_table(const SigmoidTable<S> &table, int axis, const T &x, T &through) {
    using I = IntOf<F>;
    const MaskOf<F> all(true);
    const F at = select(mask<F>(value_of(x) > F(0)), min(value_of(x), F(1)), F(0));
    I cell = gather<I>(table.cells[axis], UIntOf<F>(I(at * F(S(SigmoidTable<S>::Bins)))), mask<I>(all));
    F ends[2];
    while (true) {
        gather_rows<F>(table.nodes[axis], UIntOf<F>(cell), all, ends);
        const auto beyond = mask<I>(mask<F>(!(at < ends[1]))) && cell < table.size - 2;
        if (!any(beyond)) break;
        cell = select(beyond, cell + 1, cell);
    }
    through = (x - ends[0]) * (F(1) / (ends[1] - ends[0]));
    return UIntOf<F>(cell);
}

template <class T>
TR_INLINE T between(const T &a, const T &b, const T &t) {
    return a + t * (b - a);
}

// The coefficients of a factor, its channels being from 0 to 1.
template <class F, class T, class S>
TR_INLINE void look_up_sigmoid(const SigmoidTable<S> &table, const T (&factor)[3], T (&coefficients)[3]) {
    using U = UIntOf<F>;
    const F black(S(1e-6)), first = value_of(factor[0]), second = value_of(factor[1]), third = value_of(factor[2]);
    const auto is_first = mask<F>(!(first < second)) && mask<F>(!(first < third)),
               is_second = !is_first && mask<F>(!(second < third));
    auto turned = [&](int by) {  // of the channel that is so many behind the largest one
        return select(is_first, factor[by], select(is_second, factor[(1 + by) % 3], factor[(2 + by) % 3]));
    };
    const T top = turned(0), mean = (factor[0] + factor[1] + factor[2]) * F(S(1.0 / 3));
    const auto lit = mask<F>(value_of(top) > black);
    const T one(F(1)), bottom = select(lit, top, one);
    T t[3];
    const U value = place_in_table<F>(table, 0, select(lit, top, mean), t[0]),
            one_ratio = place_in_table<F>(table, 1, select(lit, turned(1) / bottom, one), t[1]),
            other_ratio = place_in_table<F>(table, 1, select(lit, turned(2) / bottom, one), t[2]);
    const U channel = select(mask<U>(is_first), U(0u), select(mask<U>(is_second), U(1u), U(2u)));
    const auto size = uint32_t(table.size);
    T ends[2][3];
    for (uint32_t i = 0; i < 2; ++i) {
        T edge[2][3];
        for (uint32_t j = 0; j < 2; ++j) {
            F row[8];
            const U at = ((channel * size + value + i) * size + other_ratio + j) * size + one_ratio;
            gather_long_rows<F>(table.rows, at * 4u, MaskOf<F>(true), row);
            for (int c = 0; c < 3; ++c) edge[j][c] = row[c] + t[1] * (row[4 + c] - row[c]);
        }
        for (int c = 0; c < 3; ++c) ends[i][c] = between(edge[0][c], edge[1][c], t[2]);
    }
    for (int c = 0; c < 3; ++c) coefficients[c] = between(ends[0][c], ends[1][c], t[0]);
}

}  // namespace detail

// Three coefficients and a scale: of `light` twice the largest channel, so that spectra keep their shape at any
// brightness; else 1, or the largest channel above that.
template <class F, class T, class S>
TR_INLINE void upsample_colour(const SigmoidTable<S> &table, bool light, const T (&rgb)[3], T (&out)[SigmoidChannels]) {
    const T top = detail::largest(rgb), zero(F(0)), one(F(1));
    T scale = select(mask<F>(value_of(top) < F(1)), one, top);
    if (light) scale = select(mask<F>(value_of(top) < F(0)), zero, top) * F(2);
    const auto lit = mask<F>(value_of(scale) > F(0));
    const T bottom = select(lit, scale, one);
    T factor[3], coefficients[3];
    for (int k = 0; k < 3; ++k) {
        factor[k] = select(lit, rgb[k] / bottom, T(F(0.5)));
        factor[k] = select(mask<F>(value_of(factor[k]) < F(0)), zero, factor[k]);
        factor[k] = select(mask<F>(value_of(factor[k]) > F(1)), one, factor[k]);
    }
    detail::look_up_sigmoid<F>(table, factor, coefficients);
    for (int c = 0; c < 3; ++c) out[c] = coefficients[c];
    out[3] = scale;
}

}  // namespace tr
