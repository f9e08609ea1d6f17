// What the sweeps over a tape of plain and of polarised light have in common.
#pragma once

#include "../integrator/camera.h"
#include "../integrator/classify.h"
#include "camera.h"
#include "stokes.h"
#include "sweep.h"

namespace tr {

// Whether there are vertices before: devices have null columns in place of null.
template <class S>
TR_INLINE bool has_parents(const TapeColumns<S> *parents) {
    return parents && parents->vertex.suffix[0];
}

// Every entry has at most one child.
template <class F>
TR_INLINE void hand_radiance(const TapeColumns<ScalarOf<F>> &parents, const UIntOf<F> &parent, const Spectrum<F> &r,
                             const MaskOf<F> &active) {
    for (int k = 0; k < SpectrumSize; ++k) scatter_lanes<F>(parents.vertex.suffix[k], parent, r[k], active);
}

// Of polarised light: the column of what arrives from the vertex behind, which that vertex hands on,
template <class F>
TR_INLINE void hand_stokes(const TapeColumns<ScalarOf<F>> &parents, const UIntOf<F> &parent, const Stokes<F> &s,
                           const MaskOf<F> &active) {
    hand_radiance(parents, parent, s.at[0], active);
    const auto &to = parents.stokes;
    const SpectrumColumn<ScalarOf<F>> columns[] = {to.column_q, to.column_u, to.column_v};
    for (int k = 0; k < 3; ++k)
        for (int c = 0; c < SpectrumSize; ++c) scatter_lanes<F>(columns[k][c], parent, s.at[k + 1][c], active);
    scatter_lanes<F>(to.column_axis.x, parent, s.axis.x, active);
    scatter_lanes<F>(to.column_axis.y, parent, s.axis.y, active);
    scatter_lanes<F>(to.column_axis.z, parent, s.axis.z, active);
}
template <class F>
TR_INLINE Stokes<F> column_behind(const TapeColumns<ScalarOf<F>> &tape, uint32_t i) {
    Entries<F> from(i);
    const auto &s = tape.stokes;
    return {{from(tape.vertex.suffix), from(s.column_q), from(s.column_u), from(s.column_v)}, from(s.column_axis)};
}
// ... and the row that a vertex has for it.
template <class F>
TR_INLINE void write_row(const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Stokes<F> &row) {
    const auto &to = tape.stokes;
    write(to.row_i, i, row.at[0]), write(to.row_q, i, row.at[1]);
    write(to.row_u, i, row.at[2]), write(to.row_v, i, row.at[3]);
    write(to.row_axis, i, row.axis);
}
template <class F>
TR_INLINE Stokes<F> row_before(const TapeColumns<ScalarOf<F>> &parents, const UIntOf<F> &parent,
                               const MaskOf<F> &active) {
    Gathered<F> from(parent, active);
    const auto &s = parents.stokes;
    return {{from(s.row_i), from(s.row_q), from(s.row_u), from(s.row_v)}, from(s.row_axis)};
}

// `u`, `p` and `at`: see NextVertex.
template <class F>
TR_INLINE void hand_motion(const TapeColumns<ScalarOf<F>> &parents, const UIntOf<F> &parent, const RayAdjoint<F> &ray,
                           const Vec3<F> &u, const Vec3<F> &p, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    const auto &to = parents.next;
    auto number = [&](auto *column, const auto &value) { scatter_lanes<F>(column, parent, value, active); };
    auto vector = [&](const auto &column, const Vec3<F> &value) {
        number(column.x, value.x), number(column.y, value.y), number(column.z, value.z);
    };
    vector(to.ray_o_bar, ray.o), vector(to.ray_d_bar, ray.d);
    vector(to.next_segment, u), vector(to.next_p, p);
    number(to.next_at.shape, at.shape), number(to.next_at.primitive, at.primitive);
    number(to.next_at.b1, at.b1), number(to.next_at.b2, at.b2);
}

// D / r^2 of the segment to a vertex that is glued to its surface, else 0.
template <class F>
TR_INLINE Vec3<F> glued_segment(const VertexRecord<F> &v, const MaskOf<F> &active) {
    F squared = squared_norm(v.segment);
    auto glued = active && !v.attached && !v.parallel && mask<F>(squared > F(0));
    return v.segment * select(glued, F(1) / squared, F(0));
}

template <class F>
TR_INLINE Arrival<F> arrival_of(const VertexRecord<F> &v, const Vec3<F> &d_bar, const F &log_bar) {
    return {v.attached, v.d, v.t, v.segment, d_bar, log_bar, v.parallel};
}

// The segments from whose differential sample a path goes on.
template <class F>
TR_INLINE MaskOf<F> has_branch(const SweepContext<F> &c, uint32_t level, uint32_t i, const UIntOf<F> &slot,
                               const MaskOf<F> &active) {
    using U = UIntOf<F>;
    if (!c.branches) return MaskOf<F>(false);
    Gathered<F> from(slot, active);
    return active && mask<F>(from(c.branches->level) == U(level)) &&
           mask<F>(from(c.branches->entry) == U(i) + lane_index<F>());
}

// Of a camera ray.
template <class F>
TR_NOINLINE void sweep_start(const SweepContext<F> &c, const UIntOf<F> &slot, const RayAdjoint<F> &ray,
                             const MaskOf<F> &active, GradientSink<F> &sink) {
    const Record &sensor = c.scene.sensors[c.config.sensor];
    CameraSample<F> at = camera_sample<F>(c.config, sensor, c.slots, LaneSet<F>(slot, active));
    sweep_camera(c.scene, sensor, at, c.width, c.height, ray, F(0), active, sink);
}

template <class F>
TR_INLINE void begin(const SweepContext<F> &c, const UIntOf<F> &slot, const MaskOf<F> &active, GradientSink<F> &sink) {
    LaneSet<F> lanes(slot, active);
    sink.begin(wavelengths_of<F>(c.config, lanes(c.slots.pixel), lanes(c.slots.sample)));
}

template <class F>
TR_INLINE UIntOf<F> active_only(const UIntOf<F> &index, const MaskOf<F> &active) {
    return select(mask<UIntOf<F>>(active), index, UIntOf<F>(0u));
}

// A vertex of a path through media that moves, and the segment that ends at it: what they hand to the one before, which
// is otherwise as elsewhere. `hit`, which is spent, and `d_bar` are those of the vertex, `next` what came from behind,
// `arrived` the radiance there and `branch` see sweep_segment. Returns the radiance at the segment's beginning.
template <class F>
TR_LARGE Spectrum<F> sweep_moving_segment(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                          const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i,
                                          const VertexRecord<F> &v, const NextVertex<F> &next,
                                          const SegmentPacket<F> &packet, const Spectrum<F> &delta,
                                          const Spectrum<F> &arrived, const Spectrum<F> &branch, HitAdjoint<F> &hit,
                                          Vec3<F> d_bar, const UIntOf<F> &slot, const UIntOf<F> &parent,
                                          const MaskOf<F> &active, GradientSink<F> &sink);

}  // namespace tr
