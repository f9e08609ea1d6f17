// The modified Bessel function I_0, scaled: exp(-x) I_0(x), which is finite for every x.
#pragma once

#include "dual.h"

namespace tr {

// The scaled function for x >= 0, and its slope, to the precision of the scalar type: the power series (Abramowitz and
// Stegun, "Handbook of Mathematical Functions", 9.6.12), from `far` on the asymptotic one (9.7.1). Both are sums of
// products of ratios c_k y, added by Horner's rule, so that one loop serves all lanes.
template <class F>
TR_INLINE F scaled_bessel_i0(const F &x, F &slope) {
    constexpr bool single = sizeof(ScalarOf<F>) == 4;
    constexpr int terms = single ? 17 : 34;
    constexpr double far = single ? 10 : 20;
    auto near = mask<F>(x < F(far));
    F inverse = F(1) / max(x, F(far)), y = select(near, F(0.25) * x * x, F(0.125) * inverse), sum(1), by_y(0);
    for (int k = terms; k > 0; --k) {
        F c = select(near, F(1. / (k * k)), F((2 * k - 1) * (2 * k - 1) / double(k)));
        by_y = c * fmadd(y, by_y, sum);
        sum = fmadd(c * y, sum, F(1));
    }
    F scale = select(near, exp(-min(x, F(far))), sqrt(F(1 / (2 * Pi)) * inverse)), value = scale * sum;
    slope = select(near, scale * (F(0.5) * x * by_y) - value,
                   -inverse * fmadd(scale * by_y, F(0.125) * inverse, F(0.5) * value));
    return value;
}
template <class F>
TR_INLINE F scaled_bessel_i0(const F &x) {
    F slope;
    return scaled_bessel_i0(x, slope);
}
template <class F, int N>
TR_INLINE Dual<F, N> scaled_bessel_i0(const Dual<F, N> &x) {
    F slope, value = scaled_bessel_i0(x.v, slope);
    return chain(value, slope, x);
}

}  // namespace tr
