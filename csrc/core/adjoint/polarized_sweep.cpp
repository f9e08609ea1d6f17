#include "polarized_sweep.h"

#include "sweep_parts.h"

namespace tr {

namespace {

// What the polarised passes read of a vertex.
template <class F>
struct PolarizedEntry {
    bool volumetric, collided, passes, surface;  // at most one of the last three
    UIntOf<F> slot, parent;
    VertexRecord<F> v;
    SegmentPacket<F> segment;  // through media
    Wavelengths<F> waves;
    Vec3<F> leaving;  // where light travels from here

    TR_INLINE PolarizedEntry(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, int kind, bool scatters,
                             uint32_t i, const MaskOf<F> &active)
        : volumetric(c.config.volumetric),
          collided(kind == CollisionKind),
          passes(volumetric && kind == NullKind),
          surface(kind < MissKind && scatters && !passes),
          v(read_vertex<F>(tape, i)) {
        Entries<F> from(i);
        slot = active_only<F>(from(tape.vertex.slot), active);
        parent = active_only<F>(from(tape.vertex.parent), active);
        if (surface) read_scattering(tape, i, v);
        if (collided) read_outgoing(tape, i, v);
        if (passes) v.inverse_pdf = from(tape.outgoing.inverse_pdf);
        if (volumetric) {
            read(tape.segment, from, segment);
            v.through = segment.through;
        }
        read_arrival(tape, i, v);
        leaving = -v.d;
        LaneSet<F> lanes(slot, active);
        waves = wavelengths_of<F>(c.config, lanes(c.slots.pixel), lanes(c.slots.sample));
    }
    TR_INLINE PolarizedVertex<F> vertex(const SweepContext<F> &c, int kind, const MaskOf<F> &active) const {
        return PolarizedVertex<F>(c.scene, waves, kind, v, c.needs, active);
    }
    TR_INLINE PolarizedCollision<F> collision(const SweepContext<F> &c, const MaskOf<F> &active) const {
        return PolarizedCollision<F>(c.scene, waves, segment.medium, v, active);
    }
    TR_INLINE PolarizedLight<F> emitter(const SweepContext<F> &c, const MaskOf<F> &active) const {
        return {c.scene, v.emission, active && mask<F>(v.emission_weight > F(0))};
    }
    // Of all that leaves: of what is scattered, if anything polarises it, and of what is emitted.
    TR_INLINE Stokes<F> sum(const Stokes<F> &scattered, bool polarized, const PolarizedLight<F> &emitter) const {
        Stokes<F> s = emitter.of(v.emission_radiance);
        if (polarized) s = turned_column(s, scattered.axis, leaving);
        for (int i = 0; i < 4; ++i) s.at[i] = s.at[i] + scattered.at[i];
        return s;
    }
    // What passes a boundary; without polarisation it has the axis of what is emitted there.
    TR_INLINE Stokes<F> passed(const Stokes<F> &arriving, const PolarizedLight<F> &emitter) const {
        Stokes<F> s = weighted(arriving, uniform_spectrum(v.inverse_pdf));
        s.axis = select(mask<F>(squared_norm(s.axis) > F(0)), s.axis, emitter.axis);
        return s;
    }
    // For what leaves: from the vertex before, or the film's.
    TR_INLINE Stokes<F> row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> *parents,
                            const MaskOf<F> &active) const {
        if (parents) return row_before<F>(*parents, parent, active);
        LaneSet<F> from(slot, active);
        const auto &s = c.slots;
        return {{from(s.delta), from(s.delta_q), from(s.delta_u), from(s.delta_v)},
                film_axis(c.scene, c.config.sensor, leaving)};
    }
};

}  // namespace

template <class F>
TR_LARGE void hand_column(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                          const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                          const MaskOf<F> &active) {
    const PolarizedEntry<F> entry(c, tape, kind, scatters, i, active);
    Stokes<F> s;
    const PolarizedLight<F> emitter = entry.emitter(c, active);
    if (entry.surface) {
        const PolarizedVertex<F> vertex = entry.vertex(c, kind, active);
        s = entry.sum(vertex.column(column_behind<F>(tape, i)), vertex.kind != Polarization::None, emitter);
    } else if (entry.collided) {
        s = entry.collision(c, active).column(column_behind<F>(tape, i));
    } else if (entry.passes) {
        s = entry.sum(entry.passed(column_behind<F>(tape, i), emitter), true, emitter);
    } else {
        s = emitter.of(entry.v.emission_radiance);
    }
    if (entry.volumetric) {
        s = weighted(s, entry.segment.weight);
        s.at[0] = s.at[0] + segment_emission(c.scene, entry.waves, entry.segment, active);
    }
    if (!parents && !c.columns_to)
        s = turned_column(s, film_axis(c.scene, c.config.sensor, entry.leaving), entry.leaving);
    if (parents) return hand_stokes<F>(*parents, entry.parent, s, active);
    if (c.columns_to) {  // one path a slot
        const auto &to = *c.columns_to;
        const SpectrumColumn<ScalarOf<F>> columns[] = {to.radiance, to.q, to.u, to.v};
        for (int k = 0; k < 4; ++k)
            for (int j = 0; j < SpectrumSize; ++j) scatter_lanes<F>(columns[k][j], entry.slot, s.at[k][j], active);
        scatter_lanes<F>(to.axis.x, entry.slot, s.axis.x, active);
        scatter_lanes<F>(to.axis.y, entry.slot, s.axis.y, active);
        scatter_lanes<F>(to.axis.z, entry.slot, s.axis.z, active);
        return;
    }
    if (!c.to_slots) return;
    const SpectrumColumn<ScalarOf<F>> columns[] = {c.slots.radiance, c.slots.q, c.slots.u, c.slots.v};
    for (int k = 0; k < 4; ++k) add_to_entries<F>(columns[k], entry.slot, s.at[k], active);
}

template <class F>
TR_LARGE void hand_row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                       const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                       const MaskOf<F> &active) {
    const PolarizedEntry<F> entry(c, tape, kind, scatters, i, active);
    if (!entry.surface && !entry.collided && !entry.passes) return;
    Stokes<F> row = entry.row(c, parents, active);
    if (entry.volumetric) row = weighted(row, entry.segment.weight);
    if (entry.surface) row = entry.vertex(c, kind, active).row(row);
    if (entry.collided) row = entry.collision(c, active).row(row);
    if (entry.passes) row = weighted(row, uniform_spectrum(entry.v.inverse_pdf));
    write_row<F>(tape, i, row);
}

template <class F>
TR_LARGE Stokes<F> leaving_row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                               const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i, const MaskOf<F> &active) {
    return PolarizedEntry<F>(c, tape, kind, true, i, active).row(c, parents, active);
}

namespace {

// The numbers of the segment's own derivative, which sweep_segment knows as products of throughput and radiance.
// Returns that of the path that goes on from the differential sample.
template <class F>
TR_INLINE Spectrum<F> polarize_segment(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, uint32_t level,
                                       uint32_t i, PolarizedEntry<F> &entry, const Stokes<F> &row,
                                       const MaskOf<F> &active) {
    SegmentPacket<F> &segment = entry.segment;
    const Spectrum<F> none = uniform_spectrum(F(0)), one = uniform_spectrum(F(1));
    const Vec3<F> &d = entry.v.d;
    segment.first = row.at[0];
    if (!c.branches) return none;
    const MaskOf<F> lit =
        active && mask<F>(segment.medium >= 0) && mask<F>(max_component(segment.differential_value) > F(0));
    if (any(lit)) {
        Entries<F> from(i);
        const auto &s = tape.stokes;
        Stokes<F> light{{one, none, none, none}, {F(0), F(0), F(0)}};
        if (c.scene.polarized_lights) {
            const Vec3<F> shares = from(s.differential_shares);
            light = {{one, one * shares.x, one * shares.y, one * shares.z}, from(s.differential_axis)};
        }
        segment.differential_value = differential_number(c.scene, segment, d, from(s.differential_light),
                                                         segment.differential_value, light, row, lit);
    }
    const MaskOf<F> here = has_branch(c, level, i, entry.slot, active);
    if (!any(here)) return none;
    Gathered<F> from(entry.slot, here);
    const BranchColumns<ScalarOf<F>> &b = *c.branches;
    const Stokes<F> brought{{from(b.radiance), from(b.q), from(b.u), from(b.v)}, from(b.axis)};
    return differential_number(c.scene, segment, d, from(b.wo), from(b.factor), brought, row, here);
}

}  // namespace

template <class F>
TR_LARGE void sweep_polarized_vertex(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                     const TapeColumns<ScalarOf<F>> *parents, uint32_t level, int kind, bool scatters,
                                     uint32_t i, const MaskOf<F> &active, GradientSink<F> &sink) {
    const GradientNeeds &needs = c.needs;
    PolarizedEntry<F> entry(c, tape, kind, scatters, i, active);
    const bool volumetric = entry.volumetric;
    const Spectrum<F> one = uniform_spectrum(F(1));
    VertexRecord<F> &v = entry.v;
    SegmentPacket<F> &segment = entry.segment;
    sink.begin(entry.waves);
    const Stokes<F> first = entry.row(c, parents, active), row = volumetric ? weighted(first, segment.weight) : first;
    HitAdjoint<F> hit;
    Vec3<F> d_bar{F(0), F(0), F(0)};
    NextVertex<F> next = read_next<F>(tape, i, needs.geometry && (entry.surface || entry.collided || entry.passes));
    auto lit = active && mask<F>(v.emission_weight > F(0));
    const PolarizedLight<F> emitter = entry.emitter(c, active);
    const Spectrum<F> a = emitter.contracted(row, entry.leaving);
    if ((needs.emitter || needs.geometry) && any(lit)) {
        sweep_emitter(c.scene, v.emission, v.d, a * v.emission_weight, needs, lit, hit.at, d_bar, sink);
        if (c.scene.polarized_lights) {
            Vec3<F> travel_bar{F(0), F(0), F(0)};
            hit.tangent = emitter.sweep(c.scene, v.emission, entry.leaving, row, v.emission_radiance, needs, lit,
                                        travel_bar, sink);
            d_bar = d_bar - travel_bar;
        }
    }
    F arrived = contract(a, v.emission_radiance);
    Stokes<F> left = emitter.of(v.emission_radiance);
    const auto scatter = [&](const auto &vertex, bool polarizes) {
        const Stokes<F> behind = column_behind<F>(tape, i);
        left = entry.sum(vertex.column(behind), polarizes, emitter);
        if (volumetric) segment.shadow_value = vertex.direct(row);
        if (volumetric && needs.geometry) {
            MotionPacket<F> motion;
            read(tape.motion, Entries<F>(i), motion);
            v.way = sweep_shadow_motion(c.scene, segment, motion, v.p, one, active, sink);
            next.ray.o = next.ray.o + next.rest + next.from;
        }
        arrived = arrived + vertex.sweep(c.scene, kind, v, row, behind, next, needs, active, hit, d_bar, sink);
    };
    if (entry.surface) {
        const PolarizedVertex<F> vertex = entry.vertex(c, kind, active);
        scatter(vertex, vertex.kind != Polarization::None);
    } else if (entry.collided) {
        scatter(entry.collision(c, active), true);
    } else if (entry.passes) {
        left = entry.sum(entry.passed(column_behind<F>(tape, i), emitter), true, emitter);
    }
    if (!parents && needs.geometry && kind != MissKind) {
        Vec3<F> leaving_bar{F(0), F(0), F(0)};
        const F angle_bar = component_sum(by_angle(row, turned_column(left, row.axis, entry.leaving)));
        sweep_film_axis(c.scene, c.config.sensor, entry.leaving, angle_bar, needs.camera, active, leaving_bar, sink);
        d_bar = d_bar - leaving_bar;
    }
    if (volumetric) {
        const Spectrum<F> end = number_between(row, left, entry.leaving),
                          branch = polarize_segment(c, tape, level, i, entry, first, active);
        v.beta = one;
        if (needs.geometry)
            sweep_moving_segment(c, tape, parents, kind, i, v, next, segment, one, end, branch, hit, d_bar, entry.slot,
                                 entry.parent, active, sink);
        else
            sweep_segment(c.scene, segment, one, one, end, branch, needs.medium, active, sink);
    } else if (needs.geometry) {
        RayAdjoint<F> ray{{F(0), F(0), F(0)}, d_bar};
        Vec3<F> u{F(0), F(0), F(0)};
        if (kind != MissKind) {
            ray = sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, arrived), hit, active, sink);
            u = glued_segment(v, active);
        }
        if (parents)
            hand_motion(*parents, entry.parent, ray, u, v.p, v.at, active);
        else if (needs.camera)
            sweep_start(c, entry.slot, ray, active, sink);
    }
    if (sink.forward) add_to_entries<F>(c.slots.radiance, entry.slot, sink.derivative, active);
}

#define TR_INSTANTIATE(F, S)                                                                                      \
    template void hand_column(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, bool, \
                              uint32_t, const MaskOf<F> &);                                                       \
    template void hand_row(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, bool,    \
                           uint32_t, const MaskOf<F> &);                                                          \
    template Stokes<F> leaving_row(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int,  \
                                   uint32_t, const MaskOf<F> &);                                                  \
    template void sweep_polarized_vertex(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, \
                                         uint32_t, int, bool, uint32_t, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
