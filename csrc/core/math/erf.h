// The error function's relatives that Gaussian slopes need, to the precision of the scalar type.
#pragma once

#include "dual.h"

namespace tr {

// exp(x^2) erfc(x) for x >= 0: a Chebyshev series of (1 + 2 x) exp(x^2) erfc(x) in (x - 3) / (x + 3), as proposed by
// Shepherd and Laframboise, "Chebyshev Approximation of (1 + 2x) exp(x^2) erfc x in 0 <= x < infinity", 1981. The
// coefficients are computed from the integral that defines them, in 40 digits.
template <class F>
TR_INLINE F erfc_scaled(const F &x) {
    constexpr double c[] = {
        1.17756257419656,       0.0053539045396156768,   -0.093775503422842091,   0.05436652555744322,
        -0.018976596707845207,  0.0044534260614627116,   -0.00063355317105531469, 1.7661719523171592e-5,
        1.2841532864056671e-5,  -2.0072285659059914e-6,  -1.8075227904148371e-7,  7.5498283438250928e-8,
        1.8856685238386028e-9,  -2.699519049798364e-9,   -1.4600791199391049e-11, 1.036160744596949e-10,
        1.475715976623473e-12,  -4.2773400643969108e-12, -2.07922492859799e-13,   1.8134502003176962e-13,
        1.9734255745447388e-14, -7.2879437375926732e-15, -1.5169878690228116e-15, 2.3514112258781404e-16};
    constexpr int n = sizeof(ScalarOf<F>) == 4 ? 12 : 24;
    F t = (x - F(3)) / (x + F(3)), t2 = t + t, b1(0), b2(0);
    for (int i = n - 1; i > 0; --i) {  // Clenshaw's recurrence
        F b = fmadd(t2, b1, F(c[i]) - b2);
        b2 = b1;
        b1 = b;
    }
    return fmadd(t, b1, F(c[0]) - b2) / fmadd(F(2), x, F(1));
}

// sqrt(pi) times the integral of erfc from x to infinity, x >= 0 (Abramowitz and Stegun, 7.2); its derivative is
// -sqrt(pi) erfc(x). Zero, to rounding, from 10 on.
template <class F>
TR_INLINE F erfc_integral(const F &x) {
    F a = min(x, F(10));
    return exp(-a * a) * max(F(1) - F(SqrtPi) * a * erfc_scaled(a), F(0));
}
template <class F, int N>
TR_INLINE Dual<F, N> erfc_integral(const Dual<F, N> &x) {
    F a = min(x.v, F(10));
    F e = exp(-a * a), scaled = erfc_scaled(a) * F(SqrtPi);
    F slope = select(mask<F>(x.v < F(10)), -scaled * e, F(0));
    return chain(e * max(F(1) - a * scaled, F(0)), slope, x);
}

// The x for which half of 1 + erf(x) is p, 1e-9 < p < 1 - 1e-9: the approximation for single precision of Giles,
// "Approximating the erfinv function", GPU Computing Gems, 2010; then Halley's iteration, which triples the digits.
template <class F>
TR_INLINE F erf_inverse_of_share(const F &p) {
    F q = F(1) - p, w = -log(F(4) * p * q);
    constexpr double near[] = {2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087,
                               -0.00125372503, -0.00417768164, 0.246640727,    1.50140941};
    constexpr double far[] = {-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773,
                              -0.0076224613,   0.00943887047,  1.00167406,    2.83297682};
    F a = w - F(2.5), b = sqrt(max(w, F(5))) - F(3), x(near[0]), y(far[0]);
    for (int i = 1; i < 9; ++i) {
        x = fmadd(x, a, F(near[i]));
        y = fmadd(y, b, F(far[i]));
    }
    x = select(mask<F>(w < F(5)), x, y) * (p - q);
    if constexpr (sizeof(ScalarOf<F>) == 8) {
        F tail = F(2) * min(p, q);
        for (int i = 0; i < 2; ++i) {
            F z = abs(x);
            F step = (erfc_scaled(z) - tail * exp(z * z)) * F(0.5 * SqrtPi);
            x = mulsign(z + step / (F(1) - z * step), x);
        }
    }
    return x;
}

}  // namespace tr
