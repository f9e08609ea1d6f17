#include "sweep.h"

#include "../integrator/camera.h"
#include "../integrator/classify.h"
#include "../medium/medium.h"
#include "bend.h"
#include "camera.h"

namespace tr {

namespace {

// Every entry has at most one child.
template <class F>
TR_INLINE void hand_radiance(const TapeColumns<ScalarOf<F>> &parents, const UIntOf<F> &parent, const Spectrum<F> &r,
                             const MaskOf<F> &active) {
    for (int k = 0; k < SpectrumSize; ++k) scatter_lanes<F>(parents.vertex.suffix[k], parent, r[k], active);
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

// What the path that goes on from the differential sample of these segments has brought; 0 where there is none.
template <class F>
TR_INLINE Spectrum<F> branch_radiance(const SweepContext<F> &c, uint32_t level, uint32_t i, const UIntOf<F> &slot,
                                      const MaskOf<F> &active) {
    using U = UIntOf<F>;
    if (!c.branches) return uniform_spectrum(F(0));
    Gathered<F> from(slot, active);
    auto here = active && mask<F>(from(c.branches->level) == U(level)) &&
                mask<F>(from(c.branches->entry) == U(i) + lane_index<F>());
    if (!any(here)) return uniform_spectrum(F(0));
    return Gathered<F>(slot, here)(c.branches->radiance);
}

// Of a camera ray.
template <class F>
TR_NOINLINE void sweep_start(const SweepContext<F> &c, const UIntOf<F> &slot, const RayAdjoint<F> &ray,
                             const MaskOf<F> &active, GradientSink<F> &sink) {
    const Record &sensor = c.scene.sensors[c.config.sensor];
    CameraSample<F> at = camera_sample<F>(c.config, sensor, c.slots, LaneSet<F>(slot, active));
    sweep_camera(c.scene, sensor, at, c.width, c.height, ray, F(0), active, sink);
}

// Of the ray to a vertex: straight, or bent by a medium. `log_bar`: see Arrival; `emitted_bar`: the adjoint of the
// logarithm of what is emitted at the vertex.
template <class F>
TR_INLINE RayAdjoint<F> sweep_arrival(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                                      const VertexRecord<F> &v, const Vec3<F> &d_bar, const F &log_bar,
                                      const F &emitted_bar, const F &length_bar, HitAdjoint<F> hit,
                                      const MaskOf<F> &active, GradientSink<F> &sink) {
    if (!tape.bent.medium.at)
        return sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, log_bar), hit, active, sink);
    BentPacket<F> bent;
    read(tape.bent, Entries<F>(i), bent);
    const MaskOf<F> straight = active && mask<F>(bent.medium < 0);
    RayAdjoint<F> r{{F(0), F(0), F(0)}, {F(0), F(0), F(0)}};
    if (any(straight)) {
        const RayAdjoint<F> found =
            sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, log_bar), hit, straight, sink);
        r = {select(straight, found.o, r.o), select(straight, found.d, r.d)};
    }
    for_each_bend<F>(c.scene, bent.medium, active, [&](const auto &medium, const MaskOf<F> &lanes) {
        if (any(lanes && mask<F>(abs(emitted_bar) > F(0))))  // of 1 / n^2
            sweep_index(medium, v.p, emitted_bar * F(-2) / local_index<F>(medium, v.p, lanes).n, lanes, hit, sink);
        const RayAdjoint<F> found =
            sweep_flight(c.scene, medium, bent, v.at, v.p, v.d, d_bar, length_bar, hit, lanes, sink);
        r = {select(lanes, found.o, r.o), select(lanes, found.d, r.d)};
    });
    return r;
}

// Absorption on the way of bent rays: radiance r at its end becomes that at its beginning. Returns the adjoint of its
// length.
template <class F>
TR_NOINLINE F sweep_absorption(const SceneOf<F> &scene, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                               const Spectrum<F> &a, const MaskOf<F> &active, Spectrum<F> &r, GradientSink<F> &sink) {
    Entries<F> from(i);
    const F length = from(tape.bent.length);
    const Spectrum<F> total = a * r;
    F length_bar(0);
    for_each_bend<F>(scene, from(tape.bent.medium), active, [&](const auto &medium, const MaskOf<F> &lanes) {
        const Spectrum<F> through = transmittance<F>(scene, medium, length);
        F sum(0);
        for (int c = 0; c < SpectrumSize; ++c)
            sum = fmadd(total[c], F(scene.values.constants[medium.sigma_t_offset + c]), sum);
        length_bar = select(lanes, -sum, length_bar);
        sink.spectrum(IntOf<F>(medium.sigma_t_offset), total * (-length), lanes);
        r = select(lanes, r * through, r);
    });
    return length_bar;
}

// A vertex of a path through media that moves, and the segment that ends at it: what they hand to the one before, which
// is otherwise as elsewhere. `hit` and `d_bar` are those of the vertex, `next` what came from behind, `arrived` the
// radiance there and `branch` see sweep_segment. Returns the radiance at the segment's beginning.
template <class F>
TR_NOINLINE Spectrum<F> sweep_moving_segment(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                             const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i,
                                             const VertexRecord<F> &v, const NextVertex<F> &next,
                                             const SegmentPacket<F> &packet, const Spectrum<F> &delta,
                                             const Spectrum<F> &arrived, const Spectrum<F> &branch, HitAdjoint<F> hit,
                                             Vec3<F> d_bar, const UIntOf<F> &slot, const UIntOf<F> &parent,
                                             const MaskOf<F> &active, GradientSink<F> &sink) {
    const Vec3<F> zero{F(0), F(0), F(0)};
    const bool passes = kind == NullKind, surface = kind < MissKind;
    const auto glued_behind = MaskOf<F>(passes) && active && mask<F>(squared_norm(next.segment) > F(0));
    const auto ends_glued = MaskOf<F>(surface && !passes) && active && !v.attached, chain = glued_behind || ends_glued;
    SegmentMotion<F> segment{{}, v.d, hit.p, MaskOf<F>(kind == CollisionKind), ends_glued, chain, {}, {}};
    read(tape.motion, Entries<F>(i), segment.at);
    Spectrum<F> r =
        sweep_segment(c.scene, packet, delta, v.beta, arrived, branch, c.needs.medium, active, sink, &segment);
    const F log_bar = contract(pull(delta, v.beta), arrived);
    RayAdjoint<F> ray{zero, d_bar};
    Vec3<F> u = zero, p = v.p, rest = zero, from = zero;
    SurfacePoint<F> at = v.at;
    if (surface) {
        hit.p = hit.p + segment.glued.end;
        if (passes) hit.p = hit.p + next.ray.o, d_bar = d_bar + next.ray.d;
        ray = sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, log_bar), hit, active, sink);
        if (passes) {
            u = next.segment, p = next.p, at = next.at, from = next.from;
            if (any(glued_behind)) {
                HitAdjoint<F> rest_hit;
                rest_hit.p = next.rest;
                rest = sweep_surface(c.scene, v.at, v.p, arrival_of(v, zero, F(0)), rest_hit, glued_behind, sink).o;
            }
        } else {
            u = glued_segment(v, active);
            // that of where the glued point is seen from, which is not always where the segment begins
            from = select(v.attached, zero, ray.o), ray.o = select(v.attached, ray.o, zero);
        }
    }
    rest = select(chain, rest + segment.rest.o, zero);
    ray.o = ray.o + segment.glued.o + select(chain, zero, segment.rest.o);
    ray.d = ray.d + segment.glued.d + select(chain, zero, segment.rest.d);
    if (!parents) {
        ray.o = ray.o + rest + from;
        if (c.needs.camera) sweep_start(c, slot, ray, active, sink);
        return r;
    }
    hand_motion(*parents, parent, ray, u, p, at, active);
    auto vector = [&](const auto &column, const Vec3<F> &value) {
        scatter_lanes<F>(column.x, parent, value.x, active), scatter_lanes<F>(column.y, parent, value.y, active);
        scatter_lanes<F>(column.z, parent, value.z, active);
    };
    vector(parents->motion.rest_bar, rest), vector(parents->motion.from_bar, from);
    return r;
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

// What the polarised passes read of a vertex.
template <class F>
struct PolarizedEntry {
    bool surface;
    UIntOf<F> slot, parent;
    VertexRecord<F> v;
    Wavelengths<F> waves;

    TR_INLINE PolarizedEntry(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, int kind, bool scatters,
                             uint32_t i, const MaskOf<F> &active)
        : surface(kind < MissKind && scatters), v(read_vertex<F>(tape, i)) {
        Entries<F> from(i);
        slot = active_only<F>(from(tape.vertex.slot), active);
        parent = active_only<F>(from(tape.vertex.parent), active);
        if (surface) read_scattering(tape, i, v);
        LaneSet<F> lanes(slot, active);
        waves = wavelengths_of<F>(c.config, lanes(c.slots.pixel), lanes(c.slots.sample));
    }
    TR_INLINE PolarizedVertex<F> vertex(const SweepContext<F> &c, int kind, const MaskOf<F> &active) const {
        return PolarizedVertex<F>(c.scene, waves, kind, v, active);
    }
    // Of what arrives from behind.
    TR_INLINE Stokes<F> column(const TapeColumns<ScalarOf<F>> &tape, uint32_t i) const {
        Entries<F> from(i);
        const auto &s = tape.stokes;
        return {{from(tape.vertex.suffix), from(s.column_q), from(s.column_u), from(s.column_v)}, from(s.column_axis)};
    }
    // For what leaves, towards `wi` in the world: from the vertex before, or the film's.
    TR_INLINE Stokes<F> row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> *parents, const Vec3<F> &wi,
                            const MaskOf<F> &active) const {
        if (parents) {
            Gathered<F> from(parent, active);
            const auto &s = parents->stokes;
            return {{from(s.row_i), from(s.row_q), from(s.row_u), from(s.row_v)}, from(s.row_axis)};
        }
        LaneSet<F> from(slot, active);
        const auto &s = c.slots;
        return {{from(s.delta), from(s.delta_q), from(s.delta_u), from(s.delta_v)},
                film_axis(c.scene, c.config.sensor, wi)};
    }
    TR_INLINE Vec3<F> leaving(const SweepContext<F> &c) const {
        Frame<F> frame = vertex_frame(c.scene, v);
        frame.n = frame.n * v.mirror;
        return frame.to_world(v.wi);
    }
};

// The film's axis turns with the camera, and with the direction from which light comes.
template <class F>
TR_INLINE void sweep_film_axis(const SweepContext<F> &c, const Vec3<F> &leaving, const Stokes<F> &row,
                               const Stokes<F> &column, const MaskOf<F> &active, Vec3<F> &d_bar,
                               GradientSink<F> &sink) {
    const Vec3<F> up = camera_up<F>(c.scene, c.config.sensor);
    Vec3<F> up_bar{F(0), F(0), F(0)}, leaving_bar = up_bar;
    const F angle_bar = component_sum(by_angle(row, turned_column(column, row.axis, leaving)));
    sweep_axis(up, leaving, leaving, angle_bar, up_bar, leaving_bar);
    d_bar = d_bar - leaving_bar;
    if (!c.needs.camera) return;
    const int32_t to_world = c.scene.sensors[c.config.sensor].field[Perspective::ToWorld];
    const F by_row[3] = {up_bar.x, up_bar.y, up_bar.z};
    for (int i = 0; i < 3; ++i) sink.scalar(IntOf<F>(to_world + 4 * i + 1), by_row[i], active);
}

}  // namespace

template <class F>
TR_LARGE Spectrum<F> sweep_vertex(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                  const TapeColumns<ScalarOf<F>> *parents, uint32_t level, int kind, bool scatters,
                                  uint32_t i, const MaskOf<F> &active, GradientSink<F> &sink) {
    const GradientNeeds &needs = c.needs;
    Entries<F> from(i);
    const bool volumetric = c.config.volumetric, moves = volumetric && needs.geometry;
    const bool collided = kind == CollisionKind, passes = volumetric && kind == NullKind,
               surface = kind < MissKind && scatters && !passes;
    VertexRecord<F> v = read_vertex<F>(tape, i);
    if (surface) read_scattering(tape, i, v);
    if (collided) read_outgoing(tape, i, v);
    if (passes) v.inverse_pdf = from(tape.outgoing.inverse_pdf);
    SegmentPacket<F> segment;
    if (volumetric) {
        read(tape.segment, from, segment);
        v.through = segment.through;
    }
    if (needs.geometry || collided) read_arrival(tape, i, v);
    UIntOf<F> slot = active_only<F>(from(tape.vertex.slot), active);
    Spectrum<F> delta = uniform_spectrum(F(1));
    if (!c.unit_adjoint) delta = LaneSet<F>(slot, active)(c.slots.delta);
    Spectrum<F> a = pull(delta, v.beta), r = v.emission_radiance;
    begin(c, slot, active, sink);
    HitAdjoint<F> hit;
    Vec3<F> d_bar{F(0), F(0), F(0)};
    NextVertex<F> next = read_next<F>(tape, i, needs.geometry && (surface || collided || passes));
    if (moves && (surface || collided)) {
        MotionPacket<F> motion;
        read(tape.motion, from, motion);
        v.way = sweep_shadow_motion(c.scene, segment, motion, v.p, delta, active, sink);
        next.ray.o = next.ray.o + next.rest + next.from;
    }
    auto lit = active && mask<F>(v.emission_weight > F(0));
    if ((needs.emitter || needs.geometry) && any(lit))
        sweep_emitter(c.scene, v.emission, v.d, a * v.emission_weight, needs, lit, hit.at, d_bar, sink);
    if (surface) r = r + sweep_scattering(c.scene, kind, v, a, next, needs, active, hit, d_bar, sink);
    if (passes) r = r + next.radiance * v.inverse_pdf;
    if (collided) r = r + sweep_collision(c.scene, v, segment.medium, a, next, needs, active, hit.p, d_bar, sink);
    UIntOf<F> parent = active_only<F>(from(tape.vertex.parent), active);
    if (volumetric) {
        Spectrum<F> branch = branch_radiance(c, level, i, slot, active);
        r = moves ? sweep_moving_segment(c, tape, parents, kind, i, v, next, segment, delta, r, branch, hit, d_bar,
                                         slot, parent, active, sink)
                  : sweep_segment(c.scene, segment, delta, v.beta, r, branch, needs.medium, active, sink);
    }
    const Spectrum<F> arrived = r;
    F length_bar(0);
    if (tape.bent.medium.at) length_bar = sweep_absorption(c.scene, tape, i, a, active, r, sink);
    if (parents) hand_radiance(*parents, parent, r, active);
    if (needs.geometry && !moves) {
        RayAdjoint<F> ray{{F(0), F(0), F(0)}, d_bar};
        Vec3<F> u{F(0), F(0), F(0)};
        if (kind != MissKind) {
            ray = sweep_arrival(c, tape, i, v, d_bar, contract(a, arrived), contract(a, v.emission_radiance),
                                length_bar, hit, active, sink);
            u = glued_segment(v, active);
        }
        if (parents)
            hand_motion(*parents, parent, ray, u, v.p, v.at, active);
        else if (needs.camera)
            sweep_start(c, slot, ray, active, sink);
    }
    if (sink.forward) add_to_entries<F>(c.slots.radiance, slot, sink.derivative, active);
    return r;
}

template <class F>
TR_LARGE void hand_column(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                          const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                          const MaskOf<F> &active) {
    const PolarizedEntry<F> entry(c, tape, kind, scatters, i, active);
    Stokes<F> s = no_stokes<F>();
    if (entry.surface) {
        s = entry.vertex(c, kind, active).column(entry.column(tape, i));
        const Vec3<F> k = entry.leaving(c);
        if (!parents) s = turned_column(s, film_axis(c.scene, c.config.sensor, k), k);
    }
    s.at[0] = s.at[0] + entry.v.emission_radiance;
    if (parents) {
        const auto &to = parents->stokes;
        hand_radiance(*parents, entry.parent, s.at[0], active);
        const SpectrumColumn<ScalarOf<F>> columns[] = {to.column_q, to.column_u, to.column_v};
        for (int k = 0; k < 3; ++k)
            for (int j = 0; j < SpectrumSize; ++j)
                scatter_lanes<F>(columns[k][j], entry.parent, s.at[k + 1][j], active);
        scatter_lanes<F>(to.column_axis.x, entry.parent, s.axis.x, active);
        scatter_lanes<F>(to.column_axis.y, entry.parent, s.axis.y, active);
        scatter_lanes<F>(to.column_axis.z, entry.parent, s.axis.z, active);
        return;
    }
    const SpectrumColumn<ScalarOf<F>> columns[] = {c.slots.radiance, c.slots.q, c.slots.u, c.slots.v};
    for (int k = 0; k < 4; ++k) add_to_entries<F>(columns[k], entry.slot, s.at[k], active);
}

template <class F>
TR_LARGE void hand_row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                       const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                       const MaskOf<F> &active) {
    const PolarizedEntry<F> entry(c, tape, kind, scatters, i, active);
    if (!entry.surface) return;
    const Stokes<F> row = entry.vertex(c, kind, active).row(entry.row(c, parents, entry.leaving(c), active));
    const auto &to = tape.stokes;
    write(to.row_i, i, row.at[0]), write(to.row_q, i, row.at[1]);
    write(to.row_u, i, row.at[2]), write(to.row_v, i, row.at[3]);
    write(to.row_axis, i, row.axis);
}

template <class F>
TR_LARGE Stokes<F> leaving_row(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                               const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i, const MaskOf<F> &active) {
    const PolarizedEntry<F> entry(c, tape, kind, true, i, active);
    return entry.row(c, parents, entry.leaving(c), active);
}

template <class F>
TR_LARGE void sweep_polarized_vertex(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                     const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                                     const MaskOf<F> &active, GradientSink<F> &sink) {
    const GradientNeeds &needs = c.needs;
    PolarizedEntry<F> entry(c, tape, kind, scatters, i, active);
    VertexRecord<F> &v = entry.v;
    if (needs.geometry) read_arrival(tape, i, v);
    sink.begin(entry.waves);
    const Vec3<F> leaving = entry.surface ? entry.leaving(c) : Vec3<F>{F(0), F(0), F(1)};
    const Stokes<F> row = entry.row(c, parents, leaving, active);
    const Spectrum<F> &a = row.at[0];
    HitAdjoint<F> hit;
    Vec3<F> d_bar{F(0), F(0), F(0)};
    const NextVertex<F> next = read_next<F>(tape, i, needs.geometry && entry.surface);
    auto lit = active && mask<F>(v.emission_weight > F(0));
    if ((needs.emitter || needs.geometry) && any(lit))
        sweep_emitter(c.scene, v.emission, v.d, a * v.emission_weight, needs, lit, hit.at, d_bar, sink);
    F arrived = contract(a, v.emission_radiance);
    if (entry.surface) {
        const PolarizedVertex<F> vertex = entry.vertex(c, kind, active);
        const Stokes<F> behind = entry.column(tape, i);
        if (!parents && needs.geometry) sweep_film_axis(c, leaving, row, vertex.column(behind), active, d_bar, sink);
        arrived = arrived + vertex.sweep(c.scene, kind, v, row, behind, next, needs, active, hit, d_bar, sink);
    }
    if (needs.geometry) {
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

template <class F>
TR_LARGE Vec3<F> sweep_place(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                             const TapeColumns<ScalarOf<F>> *parents, int kind, bool scatters, uint32_t i,
                             const Vec3<F> &p_bar, const MaskOf<F> &active, GradientSink<F> &sink) {
    Entries<F> from(i);
    VertexRecord<F> v = read_vertex<F>(tape, i);
    if (scatters) read_scattering(tape, i, v);
    read_arrival(tape, i, v);
    UIntOf<F> slot = active_only<F>(from(tape.vertex.slot), active);
    begin(c, slot, active, sink);
    HitAdjoint<F> hit;
    hit.p = p_bar;
    Vec3<F> d_bar{F(0), F(0), F(0)};
    NextVertex<F> next = read_next<F>(tape, i, true);
    next.radiance = uniform_spectrum(F(0));
    if (scatters && bsdf_kernels<F>(kind).is(HasDeltaLobes))
        sweep_scattering(c.scene, kind, v, uniform_spectrum(F(0)), next, c.needs, active, hit, d_bar, sink);
    else
        hit.p = hit.p + next.ray.o;
    RayAdjoint<F> ray = sweep_arrival(c, tape, i, v, d_bar, F(0), F(0), F(0), hit, active, sink);
    if (parents)
        hand_motion(*parents, active_only<F>(from(tape.vertex.parent), active), ray, {F(0), F(0), F(0)}, v.p, v.at,
                    active);
    else if (c.needs.camera && c.from_camera)
        sweep_start(c, slot, ray, active, sink);
    if (sink.forward) add_to_entries<F>(c.slots.radiance, slot, sink.derivative, active);
    return ray.o;
}

template <class F>
TR_LARGE void sweep_light_vertex(const SweepContext<F> &c, const LightSensor<ScalarOf<F>> &sensor,
                                 const TapeColumns<ScalarOf<F>> &tape, const TapeColumns<ScalarOf<F>> *parents,
                                 int kind, uint32_t i, const MaskOf<F> &active, GradientSink<F> &sink) {
    const GradientNeeds &needs = c.needs;
    Entries<F> from(i);
    VertexRecord<F> v = read_vertex<F>(tape, i);
    ConnectionRecord<F> connection = read_connection<F>(tape, i);
    NextVertex<F> next = read_next<F>(tape, i, needs.geometry);
    UIntOf<F> slot = active_only<F>(from(tape.vertex.slot), active);
    begin(c, slot, active, sink);
    if (kind == EmissionKind) {
        read_outgoing(tape, i, v);
        read_arrival(tape, i, v);
        v.normal = from(tape.scattering.normal);
        EmissionRecord<F> e{v, connection, from(tape.connection.emitter_kind), v.beta};
        sweep_emission(c.scene, sensor, e, next, needs, active, sink);
    } else {
        read_scattering(tape, i, v);
        if (needs.geometry) {
            read_arrival(tape, i, v);
        } else {
            v.d = VertexFrame<F>(c.scene, v, false).frame.to_world(v.wi) * F(-1);
            v.p = {F(0), F(0), F(0)};
        }
        HitAdjoint<F> hit;
        Vec3<F> d_bar{F(0), F(0), F(0)};
        const Spectrum<F> a = v.beta;
        Spectrum<F> r =
            sweep_light_scattering(c.scene, sensor, kind, v, connection, a, next, needs, active, hit, d_bar, sink);
        UIntOf<F> parent = active_only<F>(from(tape.vertex.parent), active);
        const Spectrum<F> arrived = r;
        F length_bar(0);
        if (tape.bent.medium.at) length_bar = sweep_absorption(c.scene, tape, i, a, active, r, sink);
        hand_radiance(*parents, parent, r, active);
        if (needs.geometry) {
            RayAdjoint<F> ray =
                sweep_arrival(c, tape, i, v, d_bar, contract(a, arrived), F(0), length_bar, hit, active, sink);
            hand_motion(*parents, parent, ray, glued_segment(v, active), v.p, v.at, active);
        }
    }
    if (sink.forward) add_to_entries<F>(c.slots.radiance, slot, sink.derivative, active);
}

#define TR_INSTANTIATE_POLARIZED(F, S)                                                                                 \
    template void hand_column(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, bool,      \
                              uint32_t, const MaskOf<F> &);                                                            \
    template void hand_row(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, bool,         \
                           uint32_t, const MaskOf<F> &);                                                               \
    template Stokes<F> leaving_row(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int,       \
                                   uint32_t, const MaskOf<F> &);                                                       \
    template void sweep_polarized_vertex(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, \
                                         bool, uint32_t, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE_POLARIZED)
#undef TR_INSTANTIATE_POLARIZED
#define TR_INSTANTIATE(F, S)                                                                                         \
    template Spectrum<F> sweep_vertex(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *,       \
                                      uint32_t, int, bool, uint32_t, const MaskOf<F> &, GradientSink<F> &);          \
    template Vec3<F> sweep_place(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, bool, \
                                 uint32_t, const Vec3<F> &, const MaskOf<F> &, GradientSink<F> &);                   \
    template void sweep_light_vertex(const SweepContext<F> &, const LightSensor<S> &, const TapeColumns<S> &,        \
                                     const TapeColumns<S> *, int, uint32_t, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
