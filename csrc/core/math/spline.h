// The uniform cubic B-spline and linear interpolation: weights of the four numbers around a fraction f in [0, 1]
// between the second and the third, and their derivatives with respect to it (Farin, "Curves and Surfaces for CAGD",
// ch. 10).
#pragma once

#include "lanes.h"

namespace tr {

template <class F>
TR_INLINE void spline_weights(const F &f, F (&w)[4]) {
    F g = F(1) - f, ff = f * f, gg = g * g;
    w[0] = gg * g * F(1. / 6);
    w[1] = F(2. / 3) - ff * (F(1) - F(0.5) * f);
    w[2] = F(2. / 3) - gg * (F(1) - F(0.5) * g);
    w[3] = ff * f * F(1. / 6);
}
template <class F>
TR_INLINE void spline_slopes(const F &f, F (&w)[4]) {
    F g = F(1) - f;
    w[0] = F(-0.5) * g * g;
    w[1] = f * (F(1.5) * f - F(2));
    w[2] = g * (F(2) - F(1.5) * g);
    w[3] = F(0.5) * f * f;
}
template <class F>
TR_INLINE void spline_curvatures(const F &f, F (&w)[4]) {
    w[0] = F(1) - f;
    w[1] = F(3) * f - F(2);
    w[2] = F(1) - F(3) * f;
    w[3] = f;
}

template <class F>
TR_INLINE void linear_weights(const F &f, F (&w)[4]) {
    w[0] = w[3] = F(0);
    w[1] = F(1) - f;
    w[2] = f;
}
template <class F>
TR_INLINE void linear_slopes(F (&w)[4]) {
    w[0] = w[3] = F(0);
    w[1] = F(-1);
    w[2] = F(1);
}

}  // namespace tr
