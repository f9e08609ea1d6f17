// Polarised light on the path tape. What is sampled, and with which density, are functions of intensities alone: paths
// are traced and recorded as ever. Columns, Stokes vectors of radiance, run over the tape from its end,
//     S_k = E_k + N_k + f_k / (p_k q_k) M_k T_k S_{k+1},
// T_k being the rotation from the axis of vertex k + 1 to that of vertex k, and M_k the matrix of math/polarization.h;
// rows, adjoints of the columns, from its beginning: A_{k+1} = A_k f_k / (p_k q_k) M_k T_k. Between a row and a column
// a vertex is the number A_k M_k R: its derivative by what the unpolarised one depends on, too, is that of f times this
// number, and what remains is the derivative of M and of the axes. Vectors alone, in one pass; matrices are never
// inverted.
#pragma once

#include "../bsdf/bsdf.h"
#include "../math/polarization.h"
#include "../sensor/perspective.h"
#include "../state/tape.h"
#include "gradient_sink.h"
#include "needs.h"

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

// The axis of the film's Stokes vectors, of light that comes along k: horizontal, by the camera's upward direction.
template <class F>
TR_INLINE Vec3<F> camera_up(const SceneOf<F> &scene, uint32_t sensor) {
    const ScalarOf<F> *m = scene.values.constants + scene.sensors[sensor].field[Perspective::ToWorld];
    return {F(m[1]), F(m[5]), F(m[9])};
}
template <class F>
TR_INLINE Vec3<F> film_axis(const SceneOf<F> &scene, uint32_t sensor, const Vec3<F> &k) {
    return axis_between(camera_up<F>(scene, sensor), k);
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

// A vertex whose BSDF is known: its matrices and axes towards the next vertex and towards the light, and the values of
// its BSDF, with those of the stack above it.
template <class F>
struct PolarizedVertex {
    const BsdfKernels<F> &bsdf;
    BsdfParameters<F> params;
    Polarization kind;
    bool smooth;
    Vec3<F> wi, wo, wo_light, n;  // in the world
    MaskOf<F> reflects, light_reflects;
    Vec3<F> axis, light_axis;  // not normalized
    Spectrum<F> path, light;   // f / (p q), and N of unpolarised light
    FacetMatrix<F> matrix[SpectrumSize], of_light[SpectrumSize];

    TR_LARGE PolarizedVertex(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind, const VertexRecord<F> &v,
                             const MaskOf<F> &active);

    // The column of what comes from here, but for its own emission, from that which arrives.
    TR_LARGE Stokes<F> column(const Stokes<F> &arriving) const;
    // The row for what arrives, from that for what leaves.
    TR_LARGE Stokes<F> row(const Stokes<F> &leaving) const;
    // The derivative, `next` being the vertex behind (whose radiance is the column `arriving`). Adds as
    // sweep_scattering does; returns the number that row and column make here, without the vertex' own emission.
    TR_LARGE F sweep(const SceneOf<F> &scene, int kind, VertexRecord<F> v, const Stokes<F> &leaving,
                     const Stokes<F> &arriving, NextVertex<F> next, const GradientNeeds &needs, const MaskOf<F> &active,
                     HitAdjoint<F> &hit, Vec3<F> &d_bar, GradientSink<F> &sink) const;

private:
    TR_HD Stokes<F> scattered(const Stokes<F> &in_axis) const;
    TR_HD void sweep_plate(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &angle,
                           Spectrum<F> &by_theta, const GradientNeeds &needs, const MaskOf<F> &active,
                           HitAdjoint<F> &hit, Vec3<F> &wi_bar) const;
};

}  // namespace tr
