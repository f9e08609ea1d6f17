#include "sweep.h"

#include "../medium/medium.h"
#include "bend.h"
#include "sweep_parts.h"

namespace tr {

namespace {

// What the path has brought that goes on from a segment's differential sample; 0 where there is none.
template <class F>
TR_INLINE Spectrum<F> branch_radiance(const SweepContext<F> &c, uint32_t level, uint32_t i, const UIntOf<F> &slot,
                                      const MaskOf<F> &active) {
    const MaskOf<F> here = has_branch(c, level, i, slot, active);
    if (!any(here)) return uniform_spectrum(F(0));
    return Gathered<F>(slot, here)(c.branches->radiance);
}

// Of the ray to a vertex: straight, or bent by a medium, with what that does to light. `log_bar`: see Arrival;
// `emitted_bar`: the adjoint of the logarithm of what is emitted at the vertex. `hit` is spent.
template <class F>
TR_INLINE RayAdjoint<F> sweep_arrival(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                                      const VertexRecord<F> &v, const Vec3<F> &d_bar, const F &log_bar,
                                      const F &emitted_bar, const BentLight<F> &light, HitAdjoint<F> &hit,
                                      const MaskOf<F> &active, GradientSink<F> &sink) {
    if (!facts::Bends || !tape.bent.medium.at)
        return sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, log_bar), hit, active, sink);
    BentPacket<F> bent;
    read(tape.bent, Entries<F>(i), bent);
    const MaskOf<F> straight = active && mask<F>(bent.medium < 0);
    RayAdjoint<F> r{{F(0), F(0), F(0)}, {F(0), F(0), F(0)}};
    if (any(straight)) {
        HitAdjoint<F> own = hit;
        const RayAdjoint<F> found =
            sweep_surface(c.scene, v.at, v.p, arrival_of(v, d_bar, log_bar), own, straight, sink);
        r = {select(straight, found.o, r.o), select(straight, found.d, r.d)};
    }
    for_each_bend<F>(c.scene, bent.medium, active, [&](const auto &medium, const MaskOf<F> &lanes) {
        if (any(lanes && mask<F>(abs(emitted_bar) > F(0))))  // of 1 / n^2
            sweep_index(medium, v.p, emitted_bar * F(-2) / local_index<F>(medium, v.p, lanes).n, lanes, hit, sink);
        const RayAdjoint<F> found = sweep_flight(c.scene, medium, bent, v.at, v.p, v.d, d_bar, light, hit, lanes, sink);
        r = {select(lanes, found.o, r.o), select(lanes, found.d, r.d)};
    });
    return r;
}

// What media do to light on the way of bent rays: radiance r at its end becomes that at its beginning. `delta`: the
// path's adjoint. Where a medium is the same everywhere and dark its derivative is added here.
template <class F>
TR_NOINLINE BentLight<F> sweep_bent_light(const SceneOf<F> &scene, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                                          const Spectrum<F> &delta, const MaskOf<F> &active, Spectrum<F> &r,
                                          GradientSink<F> &sink) {
    BentPacket<F> bent;
    read(tape.bent, Entries<F>(i), bent);
    BentLight<F> light;
    light.begin_bar = pull(delta, bent.begin), light.arrived = r;
    for_each_bend<F>(scene, bent.medium, active, [&](const auto &medium, const MaskOf<F> &lanes) {
        const Spectrum<F> left = r * transmittance<F>(bent.depth);
        if (!medium.varies) {
            const LightAlong<F> along{scene, medium.light, sink.waves};
            const Vec3<F> anywhere{F(0), F(0), F(0)};
            const Spectrum<F> total = pull(light.begin_bar, left) * F(-1);
            const int32_t offset = scene.volumes[medium.light.extinction.volume].field[ConstantVolume::Value];
            sink.spectrum(IntOf<F>(offset), total * (bent.length * along.scale()), lanes);
            const Spectrum<F> volume = along.at(medium.light.extinction, scene.values, anywhere, lanes);
            sink.number(IntOf<F>(medium.light.scale_offset), total * volume * bent.length, lanes);
            light.length_bar = select(lanes, contract(total, volume) * along.scale(), light.length_bar);
        }
        r = select(lanes, left + bent.emitted, r);
    });
    return light;
}

}  // namespace

template <class F>
TR_LARGE Spectrum<F> sweep_moving_segment(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                          const TapeColumns<ScalarOf<F>> *parents, int kind, uint32_t i,
                                          const VertexRecord<F> &v, const NextVertex<F> &next,
                                          const SegmentPacket<F> &packet, const Spectrum<F> &delta,
                                          const Spectrum<F> &arrived, const Spectrum<F> &branch, HitAdjoint<F> &hit,
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
    if (!has_parents(parents)) {
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
TR_LARGE Spectrum<F> sweep_vertex(const SweepContext<F> &c, const TapeColumns<ScalarOf<F>> &tape,
                                  const TapeColumns<ScalarOf<F>> *parents, uint32_t level, int kind, bool scatters,
                                  uint32_t i, const MaskOf<F> &given, GradientSink<F> &sink) {
    const GradientNeeds &needs = c.needs;
    Entries<F> from(i);
    UIntOf<F> slot = from(tape.vertex.slot);
    const MaskOf<F> active = given && mask<F>(slot != UIntOf<F>(NoSlot));
    if (!any(active)) return uniform_spectrum(F(0));
    slot = active_only<F>(slot, active);
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
    BentLight<F> light;
    if (facts::Bends && tape.bent.medium.at) light = sweep_bent_light(c.scene, tape, i, delta, active, r, sink);
    const bool hands_on = has_parents(parents);
    if (hands_on) hand_radiance(*parents, parent, r, active);
    if (needs.geometry && !moves) {
        RayAdjoint<F> ray{{F(0), F(0), F(0)}, d_bar};
        Vec3<F> u{F(0), F(0), F(0)};
        if (kind != MissKind) {
            ray = sweep_arrival(c, tape, i, v, d_bar, contract(a, arrived), contract(a, v.emission_radiance), light,
                                hit, active, sink);
            u = glued_segment(v, active);
        }
        if (hands_on)
            hand_motion(*parents, parent, ray, u, v.p, v.at, active);
        else if (needs.camera)
            sweep_start(c, slot, ray, active, sink);
    }
    if (sink.forward) add_to_entries<F>(c.slots.radiance, slot, sink.derivative, active);
    return r;
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
    RayAdjoint<F> ray = sweep_arrival(c, tape, i, v, d_bar, F(0), F(0), BentLight<F>{}, hit, active, sink);
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
        BentLight<F> light;
        if (facts::Bends && tape.bent.medium.at)
            light = sweep_bent_light(c.scene, tape, i, uniform_spectrum(F(1)), active, r, sink);
        hand_radiance(*parents, parent, r, active);
        if (needs.geometry) {
            RayAdjoint<F> ray =
                sweep_arrival(c, tape, i, v, d_bar, contract(a, arrived), F(0), light, hit, active, sink);
            hand_motion(*parents, parent, ray, glued_segment(v, active), v.p, v.at, active);
        }
    }
    if (sink.forward) add_to_entries<F>(c.slots.radiance, slot, sink.derivative, active);
}

#define TR_INSTANTIATE(F, S)                                                                                           \
    template Spectrum<F> sweep_vertex(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *,         \
                                      uint32_t, int, bool, uint32_t, const MaskOf<F> &, GradientSink<F> &);            \
    template Vec3<F> sweep_place(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, int, bool,   \
                                 uint32_t, const Vec3<F> &, const MaskOf<F> &, GradientSink<F> &);                     \
    template void sweep_light_vertex(const SweepContext<F> &, const LightSensor<S> &, const TapeColumns<S> &,          \
                                     const TapeColumns<S> *, int, uint32_t, const MaskOf<F> &, GradientSink<F> &);     \
    template Spectrum<F> sweep_moving_segment(const SweepContext<F> &, const TapeColumns<S> &, const TapeColumns<S> *, \
                                              int, uint32_t, const VertexRecord<F> &, const NextVertex<F> &,           \
                                              const SegmentPacket<F> &, const Spectrum<F> &, const Spectrum<F> &,      \
                                              const Spectrum<F> &, HitAdjoint<F> &, Vec3<F>, const UIntOf<F> &,        \
                                              const UIntOf<F> &, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
