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

// The number between a row and a column, colour by colour; k: where the light travels.
template <class F>
TR_INLINE Spectrum<F> number_between(const Stokes<F> &row, const Stokes<F> &column, const Vec3<F> &k) {
    const Stokes<F> r = turned_column(column, row.axis, k);
    return row.at[0] * r.at[0] + row.at[1] * r.at[1] + row.at[2] * r.at[2] + row.at[3] * r.at[3];
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
    Spectrum<F> from_light;  // what the light of the emitter sample is multiplied with, f and the albedo apart
    ScatteringMatrix<F> path, light;

    TR_LARGE PolarizedCollision(const SceneOf<F> &scene, const Wavelengths<F> &waves, const IntOf<F> &medium,
                                const VertexRecord<F> &v, const MaskOf<F> &active);

    // As those of PolarizedVertex.
    TR_LARGE Stokes<F> column(const Stokes<F> &arriving) const;
    TR_LARGE Stokes<F> row(const Stokes<F> &leaving) const;
    TR_LARGE Spectrum<F> direct(const Stokes<F> &leaving) const;
    TR_LARGE void sweep(const SceneOf<F> &scene, int kind, VertexRecord<F> v, const Stokes<F> &leaving,
                        const Stokes<F> &arriving, NextVertex<F> next, const GradientNeeds &needs,
                        const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar, GradientSink<F> &sink) const;

private:
    TR_HD Stokes<F> from_light_column() const;
    TR_HD void sweep_directions(const Stokes<F> &leaving, const Stokes<F> &arriving, Vec3<F> &wi_bar, Vec3<F> &wo_bar,
                                Vec3<F> &light_bar) const;
};

// What the medium emits into a segment, as it arrives at its beginning.
template <class F>
TR_LARGE Spectrum<F> segment_emission(const SceneOf<F> &scene, const Wavelengths<F> &waves, const SegmentPacket<F> &v,
                                      const MaskOf<F> &active);

// The numbers of a segment's differential sample, `row` being that at its beginning and d its direction: with the light
// of the emitter sample in direction wo_light; and, for the lanes of `active`, with that of the path that goes on from
// there, which has brought `arriving` along -wo and is multiplied with `factor`.
template <class F>
TR_LARGE Spectrum<F> differential_number(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Vec3<F> &d,
                                         const Vec3<F> &wo_light, const Stokes<F> &row, const MaskOf<F> &active);
template <class F>
TR_LARGE Spectrum<F> branch_number(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Vec3<F> &d,
                                   const Vec3<F> &wo, const Spectrum<F> &factor, const Stokes<F> &arriving,
                                   const Stokes<F> &row, const MaskOf<F> &active);

}  // namespace tr
