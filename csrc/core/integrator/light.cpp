#include "light.h"

#include "../bsdf/parameters.h"
#include "../medium/bend_medium.h"

namespace tr {

namespace {

// What leaves an emitter along d, divided by radiance: the cosine, or 0 behind it. Beams, and light that comes from a
// point or in one direction, cannot be connected.
template <class F>
TR_INLINE F emission_cosine(const EmissionSample<F> &e, const Vec3<F> &d, const MaskOf<F> &on_shape,
                            const MaskOf<F> &environment) {
    return select(on_shape, max(dot(e.n, d), F(0)), select(environment, F(1), F(0)));
}

template <class F>
TR_INLINE void push_connection(const PathContext<F> &c, const Vec3<F> &o, const Vec3<F> &d, const F &length,
                               const Connection<F> &to, const Spectrum<F> &value, const UIntOf<F> &slot, uint32_t i,
                               MaskOf<F> wanted, ShadowQueue<ScalarOf<F>> &connections) {
    // what is black brings nothing, but may have a derivative
    if (!c.tape) wanted = wanted && mask<F>(max_component(value) > F(0));
    if (!any(wanted)) return;
    uint32_t at = append(connections, ShadowRay<F>{o, d, length, slot, UIntOf<F>(i) + lane_index<F>()}, wanted);
    append_lanes(connections, at, ShadowValue<F>{value}, wanted);
    append_lanes(connections, at, ShadowFilm<F>{to.x, to.y}, wanted);
}

// The light itself, as the camera sees it.
template <class F>
TR_INLINE void connect_emitter(const PathContext<F> &c, const Pinhole<ScalarOf<F>> &camera, const EmissionSample<F> &e,
                               const Spectrum<F> &sent, const EmitterFlags<F> &flags, const UIntOf<F> &slot, uint32_t i,
                               ShadowQueue<ScalarOf<F>> &connections) {
    using S = ScalarOf<F>;
    auto on_shape = flags.has(IsOnShape) && !flags.has(IsBeam), environment = flags.has(IsEnvironment);
    auto infinite = flags.has(IsInfinite), visible = e.active && (on_shape || environment);
    if (!any(visible)) return;
    Connection<F> to = connect(camera, select(infinite, -e.d, e.p), infinite, visible);
    F cosine = emission_cosine(e, to.d, on_shape, environment);
    auto seen = to.seen && mask<F>(cosine > F(0));
    if (!any(seen)) return;
    F weight = cosine * e.inverse_pdf * to.importance, length = to.clear;
    Vec3<F> o = offset_origin(e.p, e.n, to.d), d = to.d;
    if (any(infinite)) {  // from the camera to where light comes from
        Vec3<F> origin{F(camera.origin.x), F(camera.origin.y), F(camera.origin.z)};
        o = select(infinite, origin - to.d * (to.distance - to.clear), o);
        d = select(infinite, -to.d, d);
        length = select(infinite, F(S(INFINITY)), length);
    }
    if (c.tape) write(c.tape->outgoing.light_weight, i, select(seen, weight, F(0)));
    push_connection(c, o, d, length, to, sent * weight, slot, i, seen, connections);
}

// The beginning of a light path on the tape, see EmissionRecord.
template <class F>
TR_INLINE void write_emission(const PathContext<F> &c, uint32_t i, const UIntOf<F> &slot, const Spectrum<F> &sent,
                              const EmissionSample<F> &e) {
    const Vec3<F> zero{F(0), F(0), F(0)}, z{F(0), F(0), F(1)};
    write_vertex(c, i, slot, slot, sent, e.point.at, no_emission<F>());
    write_arrival(c, i, e.d, e.p, zero, F(0), UIntOf<F>(uint32_t(Glued)));
    write(c.tape->outgoing, i,
          OutgoingPacket<F>{e.point.emitter, e.point.at, z, F(0), F(1), uniform_spectrum(F(0)), z, IntOf<F>(0),
                            select(e.active, e.weight, F(0))});
    write(c.tape->scattering.normal, i, e.n);
    write(c.tape->connection, i, ConnectionPacket<F>{F(0), F(0), e.n, e.kind});
}

}  // namespace

template <class F>
TR_LARGE void start_light_paths(const PathContext<F> &c, const LightSensor<ScalarOf<F>> &sensor, uint32_t i,
                                uint32_t n_slots, PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &connections) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    Entries<F> from(i);
    U slot = U(i) + lane_index<F>();
    const PathNumbers<F> numbers(c.config, from(c.slots.pixel), from(c.slots.sample), c.keys);
    Random4<F> u = numbers.draw(0, PairWanted), v = numbers.draw(EmissionBlock, PairWanted | ThirdWanted);
    F a = (F(IntOf<F>(from(c.slots.column))) + u.u[0]) * F(S(1) / sensor.camera.width);
    F b = (F(IntOf<F>(from(c.slots.row))) + u.u[1]) * F(S(1) / sensor.camera.height);
    write(c.slots.radiance, i, uniform_spectrum(F(0)));
    EmissionSample<F> e = sample_emission(c.scene, v.u[0], a, b, v.u[1], v.u[2], mask<F>(slot < U(n_slots)));
    PacketSamples<F> samples(c, slot, e.active);
    Spectrum<F> sent = eval_emitter(c.scene, samples.wavelengths(c.config), e.point, e.active, true);
    e.active = e.active && finite(c, sent, e.active, Culprit::Emitter, e.point.emitter);
    if (!c.tape || !c.needs->black_light) e.active = e.active && mask<F>(max_component(sent) > F(0));
    const EmitterFlags<F> flags(c.scene, e.kind);
    if (c.tape) write_emission(c, i, slot, sent, e);
    if (!c.config.hide_emitters && sensor.meter < 0)
        connect_emitter(c, sensor.camera, e, sent, flags, slot, i, connections);
    if (!any(e.active)) return;
    Vec3<F> o = select(flags.has(IsOnShape), offset_origin(e.p, e.n, e.d), e.p);
    // what is glued to the light, moves with it, or comes from infinitely far away: see arrival_of
    F arrival = select(flags.has(IsBeam), F(0), select(flags.has(IsInfinite), F(-1), F(1)));
    append(out,
           PathState<F>{o, e.d, F(S(INFINITY)), e.p, arrival, sent * e.weight, F(1), uniform_spectrum(F(1)), slot, slot,
                        U(1u)},
           e.active);
}

namespace {

template <class F>
struct LightScattering {
    Spectrum<F> f_camera = uniform_spectrum(F(0)), f = uniform_spectrum(F(0));  // with their corrections
    Vec3<F> wo_camera{F(0), F(0), F(1)};                                        // local
    MaskOf<F> connected{false};
    BsdfSample<F> sample{{F(0), F(0), F(1)}, F(0), F(1), IntOf<F>(0), MaskOf<F>(false)};
    F inverse_pdf{0};
    MaskOf<F> alive{false};
};

// What the stack above a BSDF makes of what it scatters; light comes along d.
template <class F>
TR_NOINLINE void scatter_through_stack(const SceneOf<F> &scene, const Interaction<F> &si, const Vec3<F> &d,
                                       const ResolvedBsdf<F> &bsdf, const Vec3<F> &to_camera, const Vec3<F> &wo,
                                       const MaskOf<F> &active, LightScattering<F> &r) {
    const BsdfStack<F> &stack = bsdf.stack;
    r.f = r.f * stack.weight;
    r.f_camera = r.f_camera * (stack.weight * stack.inverse_probability);
    r.inverse_pdf = r.inverse_pdf * stack.inverse_probability;
    PerturbationFactor<F> factor(scene, bsdf, si.frame.n, active);
    if (!any(factor.perturbed)) return;
    auto seen = !factor.hidden(-d);
    r.connected = r.connected && seen && !factor.hidden(to_camera);
    r.alive = r.alive && seen && !factor.hidden(wo);
    r.f_camera = r.f_camera * factor(to_camera, -d);
    r.f = r.f * factor(wo, -d);
    r.inverse_pdf = select(r.alive, r.inverse_pdf, F(0));
}

// One vertex. `wi` is local and mirrored where the BSDF is; `d` the direction of travel. `goes_on`: the path does.
template <class F>
TR_INLINE LightScattering<F> scatter(const PathContext<F> &c, const Wavelengths<F> &waves, const BsdfKernels<F> &bsdf,
                                     const Interaction<F> &si, const Vec3<F> &d, const Vec3<F> &wi,
                                     const ResolvedBsdf<F> &resolved, const Connection<F> &camera,
                                     const UIntOf<F> &seen, const Random4<F> &u, bool goes_on,
                                     const MaskOf<F> &active) {
    BsdfParameters<F> params;
    load_parameters(c.scene, waves, bsdf, resolved.bsdf, si.at, active, params);
    follow_waves(bsdf, seen, params);
    auto interpolated = has_shading_normal(si.shape, resolved.stack, active);
    LightScattering<F> r;
    auto looks = active && camera.seen;
    if (bsdf.is(HasSmoothLobes) && any(looks)) {
        r.wo_camera = resolved.mirror(si.frame.to_local(camera.d));
        BsdfValue<F> value;
        bsdf.eval_pdf(params, wi, r.wo_camera, Transport::Importance, value);
        r.f_camera = value.f * shading_correction(-d, camera.d, si.frame.n, si.ng, interpolated);
        r.connected = looks && mask<F>(value.pdf > F(0));  // black surfaces have derivatives, too
    }
    Vec3<F> out = si.frame.n;
    if (goes_on) {
        bsdf.sample(params, wi, u.u[0], u.u[1], u.u[2], Transport::Importance, r.sample, r.f);
        out = si.frame.to_world(resolved.mirror(r.sample.wo));
        r.f = r.f * shading_correction(-d, out, si.frame.n, si.ng, interpolated);
        r.alive = active && mask<F>(r.sample.pdf > F(0));
        r.inverse_pdf = select(r.alive, F(1) / select(r.alive, r.sample.pdf, F(1)), F(0));
    }
    if (c.scene.has_stacks) scatter_through_stack(c.scene, si, d, resolved, camera.d, out, active, r);
    return r;
}

// How the light arrived, from what start_light_paths and BSDF samples leave as its density.
template <class F>
TR_INLINE UIntOf<F> arrival_of(const F &pdf) {
    using U = UIntOf<F>;
    return select(mask<U>(mask<F>(pdf == F(0))), U(uint32_t(Attached)),
                  select(mask<U>(mask<F>(pdf < F(0))), U(uint32_t(Parallel)), U(uint32_t(Glued))));
}

}  // namespace

template <class F>
TR_LARGE void shade_light_path(const PathContext<F> &c, const LightSensor<ScalarOf<F>> &sensor, int kind,
                               const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                               const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                               PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &connections) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    const PathConfig &config = c.config;
    const M active = lanes.active;
    const bool goes_on = step.scatters, roulette = goes_on && step.depth + 1 >= config.rr_depth;
    Ray<F> ray{lanes(in.o), lanes(in.d)};
    Interaction<F> si = hit_interaction(c, ray, lanes(hits.at), lanes(hits.t), active);
    Spectrum<F> beta = lanes(in.beta);
    U slot = lanes(in.slot);
    PacketSamples<F> samples(c, slot, active);
    if (c.tape) {
        write_vertex(c, i, slot, lanes(in.parent), beta, si.at, no_emission<F>());
        if (c.keeps_arrivals()) {
            Vec3<F> segment = si.p - lanes(in.from);
            write_arrival(c, i, ray.d, si.p, segment, norm(segment), arrival_of<F>(lanes(in.pdf)));
        }
        if (c.bent) write_bent(c, i, lanes);
    }
    const BsdfKernels<F> &bsdf = bsdf_kernels<F>(kind);
    ResolvedBsdf<F> resolved = resolve_hit(c, samples, si, ray.d, step.scattering(), false, active);
    orient(c, bsdf, si, active);
    Vec3<F> wi = resolved.mirror(si.frame.to_local(-ray.d));
    const uint32_t block = BlocksPerScattering * step.scattering();
    Random4<F> u = samples.draw(BsdfBlock + block, goes_on ? numbers_of(bsdf) : 0u);
    Connection<F> to{};
    if (bsdf.is(HasSmoothLobes) && sensor.meter < 0) to = connect(sensor.camera, si.p, M(false), active);
    if (config.hide_emitters) to.seen = to.seen && mask<F>(si.shape.emitter < 0);
    LightScattering<F> s =
        scatter(c, samples.wavelengths(config), bsdf, si, ray.d, wi, resolved, to, lanes(in.seen), u, goes_on, active);
    if (sensor.meter >= 0) {
        to = IrradianceMeter::measure(c.scene, sensor.meter, si, ray.d, sensor.camera.width, sensor.camera.height,
                                      active);
        s.connected = to.seen;
        s.f_camera = uniform_spectrum(F(1));
    }

    Spectrum<F> brought = pull(beta, s.f_camera) * to.importance, weight = s.f * s.inverse_pdf, kept = weight;
    M connected = s.connected;
    if (any(connected)) connected = connected && finite(c, brought, connected, Culprit::Bsdf, resolved.bsdf);
    M alive = s.alive && finite(c, weight, s.alive, Culprit::Bsdf, resolved.bsdf);
    if (c.differentiates(&GradientNeeds::bsdf)) kept = kept_factor(weight, is_differentiated(c, resolved, active));
    Spectrum<F> survival = lanes(in.survival) * kept;
    F throughput = max_component(survival), keep(1);
    alive = alive && mask<F>(throughput > F(0));
    if (roulette)
        keep = play_roulette(throughput, F(1), samples.draw(EmitterBlock + block, FourthWanted).u[3], M(true), alive);
    if (c.tape) {
        OutgoingPacket<F> outgoing = passing<F>(select(alive, s.inverse_pdf * keep, F(0)));
        outgoing.wo_light = s.wo_camera, outgoing.light_weight = select(connected, to.importance, F(0));
        outgoing.wo = s.sample.wo, outgoing.lobe = s.sample.lobe;
        write_scattering(c, i, resolved, si, wi, outgoing);
        write(c.tape->connection, i, ConnectionPacket<F>{F(0), F(0), si.ng, IntOf<F>(-1)});
    }
    if (any(connected))
        push_connection(c, offset_origin(si.p, si.ng, to.d), to.d, to.clear, to, brought, slot, i, connected,
                        connections);
    if (!any(alive)) return;
    Vec3<F> d = normalize(si.frame.to_world(resolved.mirror(s.sample.wo)));
    F pdf = select(s.sample.delta, F(0), s.sample.pdf);
    IntOf<F> medium(-1);
    if (c.bent) {
        medium = medium_behind(c.scene, si.at.shape, si.ng, d, lanes(in.medium), alive);
        pdf = select(bends<F>(c.scene, medium, alive), F(0), pdf);  // what comes bent is not glued to its surface
    }
    uint32_t at = append(
        out,
        PathState<F>{offset_origin(si.p, si.ng, d), d, F(S(INFINITY)), si.p, pdf, pull(beta, weight) * keep, F(1),
                     survival * keep, slot, U(i) + lane_index<F>(), seen_after<F>(bsdf, s.sample.lobe, lanes(in.seen))},
        alive);
    if (c.bent) append_lanes(out, at, PathMedium<F>{medium, U(0u), uniform_spectrum(F(1)), F(0)}, alive);
}

#define TR_INSTANTIATE(F, S)                                                                                  \
    template void start_light_paths(const PathContext<F> &, const LightSensor<S> &, uint32_t, uint32_t,       \
                                    PathQueue<S> &, ShadowQueue<S> &);                                        \
    template void shade_light_path(const PathContext<F> &, const LightSensor<S> &, int, const PathStep &,     \
                                   const PathQueue<S> &, const HitColumns<S> &, const LaneSet<F> &, uint32_t, \
                                   PathQueue<S> &, ShadowQueue<S> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
