// Stokes vectors on an axis, as rows and columns of polarised light; see polarization.h.
#pragma once

#include "../color/spectrum.h"
#include "../math/polarization.h"

namespace tr {

// A row or a column, each component with its colours, and its axis.
template <class F>
struct Stokes {
    Spectrum<F> at[4];
    Vec3<F> axis;
};

template <class F>
TR_INLINE Stokes<F> no_stokes() {
    const Spectrum<F> zero = uniform_spectrum(F(0));
    return {{zero, zero, zero, zero}, {F(0), F(0), F(0)}};
}

// On another axis; k: where the light travels.
template <class F>
TR_INLINE Stokes<F> turned_column(Stokes<F> r, const Vec3<F> &axis, const Vec3<F> &k) {
    const StokesRotation<F> t(r.axis, axis, k);
    const Spectrum<F> q = r.at[1], u = r.at[2];
    r.at[1] = q * t.c + u * t.s, r.at[2] = u * t.c - q * t.s;
    r.axis = axis;
    return r;
}
template <class F>
TR_INLINE Stokes<F> turned_row(Stokes<F> a, const Vec3<F> &axis, const Vec3<F> &k) {
    return turned_column(a, axis, k);  // a rotation's inverse is its transpose
}

// Of light that travels the other way: U is seen from behind.
template <class F>
TR_INLINE Stokes<F> seen_from_behind(Stokes<F> s) {
    s.at[2] = s.at[2] * F(-1);
    return s;
}

// The number between a row and a column, colour by colour.
template <class F>
TR_INLINE Spectrum<F> number_between(const Stokes<F> &row, const Stokes<F> &column, const Vec3<F> &k) {
    const Stokes<F> r = turned_column(column, row.axis, k);
    return row.at[0] * r.at[0] + row.at[1] * r.at[1] + row.at[2] * r.at[2] + row.at[3] * r.at[3];
}

// The derivative of the number by the angle of the row's axis, on which both are; by that of the axis which the column
// had before it is the negative.
template <class F>
TR_INLINE Spectrum<F> by_angle(const Stokes<F> &a, const Stokes<F> &r) {
    return (a.at[1] * r.at[2] - a.at[2] * r.at[1]) * F(2);
}

// Perpendicular to both directions.
template <class F>
TR_INLINE Vec3<F> axis_between(const Vec3<F> &a, const Vec3<F> &b) {
    Vec3<F> m = cross(a, b), s, t;
    coordinate_system(a, s, t);
    return select(mask<F>(squared_norm(m) > F(1e-12)), m, s);
}

// Adds to the adjoints of a and b what the angle of a x b makes of `angle_bar`, seen along k.
template <class F>
TR_INLINE void sweep_axis(const Vec3<F> &a, const Vec3<F> &b, const Vec3<F> &k, const F &angle_bar, Vec3<F> &a_bar,
                          Vec3<F> &b_bar) {
    const Vec3<F> m = cross(a, b);
    const F length2 = squared_norm(m);
    auto some = mask<F>(length2 > F(1e-12));
    const Vec3<F> m_bar = cross(k, m) * select(some, angle_bar / select(some, length2, F(1)), F(0));
    a_bar = a_bar + cross(b, m_bar), b_bar = b_bar + cross(m_bar, a);
}

}  // namespace tr
