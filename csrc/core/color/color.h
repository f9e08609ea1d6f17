// Colour: C channels (1 = mono, 3 = RGB). The integrators multiply, add and ask for the largest channel, by name, so
// that sampled wavelengths (C = 4) and Mueller matrices can take this place.
#pragma once

#include "../math/vector.h"

namespace tr {

template <class F, int C>
struct Color {
    F c[C];

    TR_INLINE F &operator[](int i) { return c[i]; }
    TR_INLINE const F &operator[](int i) const { return c[i]; }
};

template <int C, class F>
TR_INLINE Color<F, C> uniform_color(const F &x) {
    Color<F, C> r;
    for (int i = 0; i < C; ++i) r.c[i] = x;
    return r;
}
#define TR_COLOR_OP(op)                                                      \
    template <class A, class B, int C>                                       \
    TR_INLINE auto operator op(const Color<A, C> &a, const Color<B, C> &b) { \
        Color<decltype(a.c[0] op b.c[0]), C> r;                              \
        for (int i = 0; i < C; ++i) r.c[i] = a.c[i] op b.c[i];               \
        return r;                                                            \
    }
TR_COLOR_OP(+)
TR_COLOR_OP(-)
TR_COLOR_OP(*)
#undef TR_COLOR_OP
template <class A, class B, int C>
TR_INLINE auto operator*(const Color<A, C> &a, const B &s) {
    Color<decltype(a.c[0] * s), C> r;
    for (int i = 0; i < C; ++i) r.c[i] = a.c[i] * s;
    return r;
}
template <class M, class F, int C>
TR_INLINE Color<F, C> select(const M &m, const Color<F, C> &a, const Color<F, C> &b) {
    Color<F, C> r;
    for (int i = 0; i < C; ++i) r.c[i] = select(m, a.c[i], b.c[i]);
    return r;
}
template <class F, int C>
TR_INLINE Color<F, C> max_with(const Color<F, C> &a, const F &b) {
    Color<F, C> r;
    for (int i = 0; i < C; ++i) r.c[i] = max(a.c[i], b);
    return r;
}
template <class F, int C>
TR_INLINE Color<F, C> magnitude(const Color<F, C> &a) {
    Color<F, C> r;
    for (int i = 0; i < C; ++i) r.c[i] = abs(a.c[i]);
    return r;
}

// The largest magnitude: a step of an optimiser may make a colour negative, which must not end paths.
template <class F, int C>
TR_INLINE F max_channel(const Color<F, C> &a) {
    F r = abs(a.c[0]);
    for (int i = 1; i < C; ++i) r = max(r, abs(a.c[i]));
    return r;
}
template <class F, int C>
TR_INLINE MaskOf<F> is_finite(const Color<F, C> &a) {
    F sum = a.c[0] - a.c[0];  // NaN unless finite
    for (int i = 1; i < C; ++i) sum = sum + (a.c[i] - a.c[i]);
    return mask<F>(sum == F(0));
}

// ITU-R BT.709 luminance: importance of an environment's texels.
template <class F, int C>
TR_INLINE F luminance(const Color<F, C> &a) {
    if constexpr (C == 3)
        return F(0.2126) * a.c[0] + F(0.7152) * a.c[1] + F(0.0722) * a.c[2];
    else
        return a.c[0];
}
// The adjoint of a colour of whose luminance g is the adjoint, by channels of what depends on it.
template <class F, int C>
TR_INLINE Color<F, C> luminance_adjoint(const Color<F, C> &g) {
    if constexpr (C == 3) {
        F sum = g.c[0] + g.c[1] + g.c[2];
        return {{F(0.2126) * sum, F(0.7152) * sum, F(0.0722) * sum}};
    } else {
        return g;
    }
}

}  // namespace tr
