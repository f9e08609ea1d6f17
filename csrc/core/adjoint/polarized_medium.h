// Polarised light in media. Transmittance multiplies rows and columns, boundaries that do not scatter pass them on, and
// what media emit is unpolarised. A collision has the matrix of its phase function (scattering_matrix.h): with the row
// A and the column R, both on the axis across the plane of scattering, the number between them is
//     albedo / (p q) (f A0 R0 + b (A0 R1 + A1 R0) + q A1 R1 + x (A2 R2 + A3 R3)),
// the first term of which is that of light without polarisation.
//
// A segment's derivative needs radiance weighted with throughput, times the path's adjoint; here the number between
// a row and a column takes the place of this product, colour by colour.
#pragma once

#include "medium.h"
#include "polarization.h"
#include "scattering_matrix.h"

namespace tr {

template <class F>
TR_INLINE Stokes<F> weighted(Stokes<F> s, const Spectrum<F> &by) {
    for (auto &part : s.at) part = part * by;
    return s;
}

// What the matrix adds to f A0 R0, row and column being on its axis.
template <class F>
TR_INLINE Spectrum<F> polarized_part(const ScatteringMatrix<F> &m, const Stokes<F> &a, const Stokes<F> &r) {
    return (a.at[0] * r.at[1] + a.at[1] * r.at[0]) * m.b + a.at[1] * r.at[1] * m.q +
           (a.at[2] * r.at[2] + a.at[3] * r.at[3]) * m.x;
}

// A collision, `d` being the path's direction of travel before it.
template <class F>
struct PolarizedCollision {
    IntOf<F> medium;
    bool polarizes;  // in a lane at least; else axes do not matter
    Vec3<F> wi, wo, wo_light;
    Vec3<F> axis, light_axis;  // not normalized
    Spectrum<F> albedo;
    F inverse_pdf, share;    // of Rayleigh's part
    Spectrum<F> from_light;  // N of unpolarised light, but for f and the albedo
    PolarizedLight<F> lamp;
    ScatteringMatrix<F> path, light;

    TR_LARGE PolarizedCollision(const SceneOf<F> &scene, const Wavelengths<F> &waves, const IntOf<F> &medium,
                                const VertexRecord<F> &v, const MaskOf<F> &active);

    // As those of PolarizedVertex.
    TR_LARGE Stokes<F> column(const Stokes<F> &arriving) const;
    TR_LARGE Stokes<F> row(const Stokes<F> &leaving) const;
    TR_LARGE Spectrum<F> direct(const Stokes<F> &leaving) const;
    TR_LARGE F sweep(const SceneOf<F> &scene, int kind, VertexRecord<F> v, const Stokes<F> &leaving,
                     const Stokes<F> &arriving, NextVertex<F> next, const GradientNeeds &needs, const MaskOf<F> &active,
                     HitAdjoint<F> &hit, Vec3<F> &d_bar, GradientSink<F> &sink) const;

private:
    // A way: where the light comes from, the axis, the matrix and its factor.
    struct Way {
        const Vec3<F> &to, &axis;
        const ScatteringMatrix<F> &matrix;
        Spectrum<F> factor;
    };
    TR_HD Way path_way() const { return {wo, axis, path, albedo * inverse_pdf}; }
    TR_HD Way light_way() const { return {wo_light, light_axis, light, apply(albedo, from_light)}; }
    TR_HD Stokes<F> sent() const { return turned_column(lamp.of(uniform_spectrum(F(1))), light_axis, -wo_light); }

    // A column behind the matrix, and a row before it; both on the axis of the way.
    TR_HD Stokes<F> scattered(const Way &way, const Stokes<F> &arriving) const;
    // Of the matrix by its cosine and axis, between a row and a column that are on it.
    TR_HD void sweep_way(const Way &way, const Stokes<F> &leaving, const Stokes<F> &row, const Stokes<F> &column,
                         Vec3<F> &wi_bar, Vec3<F> &to_bar) const;
    TR_HD void sweep_lamp(const SceneOf<F> &scene, const VertexRecord<F> &v, const Stokes<F> &row,
                          const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &to_bar,
                          GradientSink<F> &sink) const;
};

// What the medium emits into a segment, as it arrives at its beginning.
template <class F>
TR_LARGE Spectrum<F> segment_emission(const SceneOf<F> &scene, const Wavelengths<F> &waves, const SegmentPacket<F> &v,
                                      const MaskOf<F> &active);

// Of what arrives at a segment's differential sample from the direction wo, and is multiplied with `factor` times the
// matrix over f, the number with the row at the segment's beginning; d: the segment's direction.
template <class F>
TR_LARGE Spectrum<F> differential_number(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Vec3<F> &d,
                                         const Vec3<F> &wo, const Spectrum<F> &factor, const Stokes<F> &arriving,
                                         const Stokes<F> &row, const MaskOf<F> &active);

}  // namespace tr
