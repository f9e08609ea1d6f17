#include "surface.h"

#include "../bsdf/parameters.h"
#include "../medium/bend_medium.h"
#include "medium.h"

namespace tr {

template <class F>
TR_LARGE ResolvedBsdf<F> resolve_hit(const PathContext<F> &c, const PacketSamples<F> &samples, Interaction<F> &si,
                                     const Vec3<F> &d, uint32_t scattering, bool viewed, const MaskOf<F> &active) {
    if (!c.scene.has_stacks) return resolve_bsdf<F>(c.scene, si.shape.bsdf, mask<F>(dot(si.frame.n, d) > F(0)), active);
    Random4<F> u = samples.draw(BsdfBlock + BlocksPerScattering * scattering, FourthWanted);
    const int32_t *differentiated = c.differentiates(&GradientNeeds::bsdf) ? c.needs->bsdfs : nullptr;
    return resolve_stack(c.scene, samples.wavelengths(c.config), si, d, u.u[3], viewed, differentiated, active);
}

namespace {

// One scattering: an emitter sample and a BSDF sample at a vertex.
template <class F>
struct Scattering {
    // N = f_light * emitted * light_weight where the shadow ray is free
    EmitterSample<F> light = no_emitter_sample<F>();
    Vec3<F> wo_light{F(0), F(0), F(1)};  // local
    Spectrum<F> emitted = uniform_spectrum(F(0)), f_light = uniform_spectrum(F(0));
    F light_weight{0};
    MaskOf<F> shadow_ray{false};
    BsdfSample<F> sample;
    Spectrum<F> f;
    F inverse_pdf;  // before Russian roulette
    MaskOf<F> alive;
};

// What the stack above a BSDF makes of what it scatters.
template <class F>
TR_NOINLINE void scatter_through_stack(const SceneOf<F> &scene, const Interaction<F> &si, const Vec3<F> &wi,
                                       const ResolvedBsdf<F> &bsdf, const MaskOf<F> &active, Scattering<F> &r) {
    const BsdfStack<F> &stack = bsdf.stack;
    r.f = r.f * stack.weight;
    r.f_light = r.f_light * stack.weight;
    r.inverse_pdf = r.inverse_pdf * stack.inverse_probability;
    r.light_weight = r.light_weight * stack.inverse_probability;
    PerturbationFactor<F> factor(scene, bsdf, si.frame.n, active);
    if (!any(factor.perturbed)) return;
    Vec3<F> wo = si.frame.to_world(bsdf.mirror(r.sample.wo));
    auto seen = !factor.hidden(si.frame.to_world(bsdf.mirror(wi)));
    r.shadow_ray = r.shadow_ray && seen && !factor.hidden(r.light.d);
    r.alive = r.alive && seen && !factor.hidden(wo);
    r.f_light = r.f_light * factor(r.light.d, r.light.d);
    r.f = r.f * factor(wo, wo);
    r.light_weight = select(r.shadow_ray, r.light_weight, F(0));
    r.inverse_pdf = select(r.alive, r.inverse_pdf, F(0));
}

// An emitter sample, weighted against the BSDF's density.
template <class F>
TR_INLINE void sample_light(const PathContext<F> &c, const Wavelengths<F> &waves, const BsdfKernels<F> &bsdf,
                            const BsdfParameters<F> &params, const Interaction<F> &si, const Vec3<F> &wi,
                            const ResolvedBsdf<F> &resolved, const Random4<F> &u, const F &n_light, const F &n_bsdf,
                            const MaskOf<F> &active, Scattering<F> &r) {
    r.light = sample_emitter(c.scene, si.p, u.u[0], u.u[1], u.u[2], active);
    r.wo_light = resolved.mirror(si.frame.to_local(r.light.d));
    BsdfValue<F> value;
    bsdf.eval_pdf(params, wi, r.wo_light, Transport::Radiance, value);
    r.f_light = value.f;
    // a black reflectance still has a derivative: what matters is that the direction is possible
    r.shadow_ray = active && mask<F>(r.light.pdf > F(0)) && mask<F>(value.pdf > F(0));
    if (!any(r.shadow_ray)) return;
    r.light_weight = emitter_sample_weight(r.light, value.pdf, n_light, n_bsdf, r.shadow_ray);
    r.emitted = eval_emitter(c.scene, waves, r.light.point, r.shadow_ray);
}

// Light in a medium that bends it does not come straight from emitters: what is found there counts alone. Likewise
// along the sampled direction, which then is as good as that of a delta lobe.
template <class F>
TR_NOINLINE void leave_bending(const SceneOf<F> &scene, const Interaction<F> &si, const IntOf<F> &medium,
                               const ResolvedBsdf<F> &resolved, const MaskOf<F> &active, Scattering<F> &s) {
    const Vec3<F> d = si.frame.to_world(resolved.mirror(s.sample.wo));
    const IntOf<F> to_light = medium_behind(scene, si.at.shape, si.ng, s.light.d, medium, active),
                   onwards = medium_behind(scene, si.at.shape, si.ng, d, medium, active);
    s.shadow_ray = s.shadow_ray && !bends<F>(scene, to_light, active);
    s.light_weight = select(s.shadow_ray, s.light_weight, F(0));
    s.sample.delta = s.sample.delta || bends<F>(scene, onwards, active);
}

// Of the light in media that bend it paths carry L / n^2. Returns the lanes that came bent.
template <class F>
TR_NOINLINE MaskOf<F> arrive_bent(const PathContext<F> &c, const LaneSet<F> &lanes, const Vec3<F> &p,
                                  FoundEmission<F> &e) {
    using M = MaskOf<F>;
    const IntOf<F> within = lanes(c.bent->medium);
    for_each_bend<F>(c.scene, within, lanes.active && mask<F>(e.weight > F(0)),
                     [&](const auto &inside, const M &there) {
                         const F n = local_index<F>(inside, p, there).n, factor = select(there, F(1) / (n * n), F(1));
                         e.weight = e.weight * factor, e.radiance = e.radiance * factor;
                     });
    return lanes.active && mask<F>(within >= 0);
}

// `lit`: lanes in which an emitter sample counts.
template <class F>
TR_INLINE Scattering<F> scatter(const PathContext<F> &c, const Wavelengths<F> &waves, const BsdfKernels<F> &bsdf,
                                const Interaction<F> &si, const Vec3<F> &wi, const ResolvedBsdf<F> &resolved,
                                const PathStep &step, const UIntOf<F> &seen, const Random4<F> &u_light,
                                const Random4<F> &u_bsdf, const MaskOf<F> &active, const MaskOf<F> &lit) {
    using S = ScalarOf<F>;
    BsdfParameters<F> params;
    load_parameters(c.scene, waves, bsdf, resolved.bsdf, si.at, active, params);
    follow_waves(bsdf, seen, params);
    const bool first = step.depth == 0;
    F n_light(S(first ? c.config.emitter_samples : 1)), n_bsdf(S(first ? c.config.bsdf_samples : 1));
    Scattering<F> r;
    if (any(lit)) sample_light(c, waves, bsdf, params, si, wi, resolved, u_light, n_light, n_bsdf, lit, r);
    bsdf.sample(params, wi, u_bsdf.u[0], u_bsdf.u[1], u_bsdf.u[2], Transport::Radiance, r.sample, r.f);
    r.alive = active && mask<F>(r.sample.pdf > F(0)) && mask<F>(F(S(step.split)) < n_bsdf);
    r.inverse_pdf = select(r.alive, F(1) / select(r.alive, n_bsdf * r.sample.pdf, F(1)), F(0));
    if (c.scene.has_stacks) scatter_through_stack(c.scene, si, wi, resolved, active, r);
    return r;
}

// Towards the sampled point from where the ray really starts.
template <class F>
TR_INLINE void push_light_ray(const PathContext<F> &c, const Interaction<F> &si, Scattering<F> &s,
                              const Spectrum<F> &beta, const UIntOf<F> &slot, uint32_t i, const IntOf<F> &bsdf,
                              const IntOf<F> &medium, ShadowQueue<ScalarOf<F>> &shadows) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    auto wanted = s.shadow_ray;
    if (!any(wanted)) return;
    Spectrum<F> contribution = apply(pull(beta, s.f_light), s.emitted) * s.light_weight;
    wanted = wanted && finite(c, contribution, wanted, Culprit::Bsdf, bsdf);
    s.light_weight = select(wanted, s.light_weight, F(0));
    // what is black contributes nothing, but may have a derivative
    if (!c.tape && !c.keeps_black) wanted = wanted && mask<F>(max_component(contribution) > F(0));
    if (!any(wanted)) return;
    auto near = mask<F>(s.light.distance < F(S(1e30)));
    ShadowRay<F> ray;
    ray.o = offset_origin(si.p, si.ng, s.light.d);
    Direction<F> to_light(si.p + s.light.d * select(near, s.light.distance, F(1)) - ray.o);
    ray.d = select(near, to_light.d, s.light.d);
    ray.length = select(near, to_light.length * F(1 - ShadowEpsilon), F(S(INFINITY)));
    ray.slot = slot;
    ray.position = U(i) + lane_index<F>();
    uint32_t at = append(shadows, ray, wanted);
    if (!c.tape || c.config.volumetric) append_lanes(shadows, at, ShadowValue<F>{contribution}, wanted);
    if (c.config.volumetric)
        append_lanes(shadows, at,
                     ShadowMedium<F>{medium_behind(c.scene, si.at.shape, si.ng, ray.d, medium, wanted),
                                     dot(ray.o - si.p, ray.d), U(uint32_t(ShadowPurpose::Vertex))},
                     wanted);
}

}  // namespace

template <class F>
TR_LARGE void shade_surface(const PathContext<F> &c, int kind, const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                            const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                            PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &shadows) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    const PathConfig &config = c.config;
    const bool volumetric = config.volumetric, invisible = kind == NullKind || kind == MaskHoleKind;
    const M active = lanes.active;
    Ray<F> ray{lanes(in.o), lanes(in.d)};
    Interaction<F> si = hit_interaction(c, ray, lanes(hits.at), lanes(hits.t), active);
    const F cos_i = -dot(si.frame.n, ray.d);
    PreviousVertex<F> from{lanes(in.from), lanes(in.pdf)};
    Spectrum<F> beta = lanes(in.beta);
    U slot = lanes(in.slot);
    PacketSamples<F> samples(c, slot, active);
    Wavelengths<F> waves = samples.wavelengths(config);

    const bool passes = volumetric && kind == NullKind;
    M shown = passes && config.hide_emitters ? active && !mask<F>(lanes(in.depth) == U(0u)) : active;
    FoundEmission<F> e =
        step.split == 0 ? surface_emission(c, waves, si, cos_i, from, shown, step.depth) : no_emission<F>();
    M bent(false);
    if (c.bent) bent = arrive_bent(c, lanes, si.p, e);
    if (c.tape) {
        write_vertex(c, i, slot_on_tape(c, slot, lanes(in.seen)), lanes(in.parent), beta, si.at, e);
        if (c.keeps_arrivals()) {
            Vec3<F> segment = si.p - from.p;
            // light is sampled by places, which are glued to what emits; all else by directions, in which points slide
            auto slides = mask<F>(from.pdf == F(0)) || mask<F>(si.shape.emitter < 0) || M(passes) || bent;
            U arrival = arrival_kind<F>(slides);
            F t = si.t;
            if (volumetric) {  // boundaries hand directions on, but those that were sampled rest
                arrival = select(mask<U>(slides && !mask<F>(from.pdf == F(0))), U(uint32_t(Resting)), arrival);
                t = t + lanes(in.ray_offset);
            }
            write_arrival(c, i, ray.d, si.p, segment, step.depth == 0 ? norm(segment) : t, arrival);
        }
        if (c.bent) write_bent(c, i, lanes);
    } else {
        add_radiance(c, slot, beta, e, active, Culprit::Emitter);
    }
    U seen = lanes(in.seen);
    if (!c.tape && !invisible) mark_seen(c, slot, seen, active);
    if (!step.scatters) return;
    if (passes) return pass_boundary(c, in, hits, lanes, i, si, out);

    M may = active, counted(true);  // lanes that may scatter; those that roulette may end
    U path_depth = U(uint32_t(step.depth));
    I medium(-1);
    if (c.bent) medium = lanes(in.medium);
    if (volumetric) {
        path_depth = lanes(in.depth);
        medium = lanes(in.medium);
        may = active && may_scatter<F>(config, path_depth);
        counted = mask<F>(I(path_depth) + 1 >= I(config.rr_depth));
    }
    const bool roulette = volumetric ? any(counted) : step.depth + 1 >= config.rr_depth;

    const BsdfKernels<F> &bsdf = bsdf_kernels<F>(kind);
    ResolvedBsdf<F> resolved = resolve_hit(c, samples, si, ray.d, step.scattering(), true, active);
    orient(c, bsdf, si, active);
    Vec3<F> wi = resolved.mirror(si.frame.to_local(-ray.d));
    const uint32_t block = BlocksPerScattering * step.scattering();
    const bool differentiates = c.differentiates(&GradientNeeds::bsdf);
    const bool samples_lights =
        bsdf.is(HasSmoothLobes) && c.scene.n_emitters > 0 && step.split < config.emitter_samples;
    M differentiated(false), lit = may && M(samples_lights);
    if (differentiates) differentiated = is_differentiated(c, resolved, active);
    if (c.bsdfs_alone) {
        seen = select(mask<U>(differentiated), seen | SeenDifferentiated, seen);
        lit = lit && has_differentiated<F>(seen);
        if (any(differentiated)) write(c.tape->vertex.slot, i, slot_on_tape(c, slot, seen));
    }
    const uint32_t of_light = (any(lit) ? PairWanted | ThirdWanted : 0u) | (roulette ? FourthWanted : 0u);
    Random4<F> u_light = samples.draw(EmitterBlock + block, of_light);
    Random4<F> u_bsdf = samples.draw(BsdfBlock + block, numbers_of(bsdf));
    Scattering<F> s = scatter(c, waves, bsdf, si, wi, resolved, step, seen, u_light, u_bsdf, may, lit);
    if (c.bent) leave_bending(c.scene, si, medium, resolved, active, s);
    push_light_ray(c, si, s, beta, slot, i, resolved.bsdf, medium, shadows);

    Spectrum<F> weight = s.f * s.inverse_pdf, kept = weight;
    M alive = s.alive && finite(c, weight, s.alive, Culprit::Bsdf, resolved.bsdf);
    if (differentiates) kept = kept_factor(weight, differentiated);
    Spectrum<F> survival = lanes(in.survival) * kept;
    F eta = lanes(in.eta) * s.sample.eta, keep(1), throughput = max_component(survival);
    alive = alive && mask<F>(throughput > F(0));
    if (roulette) keep = play_roulette(throughput, eta, u_light.u[3], counted, alive);
    if (c.tape) {
        // (where no path goes on the sample is of parameters that were not loaded, and may be anything)
        const Vec3<F> wo = select(alive, s.sample.wo, Vec3<F>{F(0), F(0), F(1)});
        const I lobe = select(mask<I>(alive), s.sample.lobe, I(0));
        write_scattering(c, i, resolved, si, wi,
                         {s.light.point.emitter, s.light.point.at, s.wo_light, s.light_weight, s.light.distance,
                          s.emitted, wo, lobe, select(alive, s.inverse_pdf * keep, F(0))});
    }
    if (!any(alive)) return;
    Vec3<F> d = normalize(si.frame.to_world(resolved.mirror(s.sample.wo))), o = offset_origin(si.p, si.ng, d);
    PathState<F> next{o,
                      d,
                      F(S(INFINITY)),
                      si.p,
                      select(s.sample.delta, F(0), s.sample.pdf),
                      pull(beta, weight) * keep,
                      eta,
                      survival * keep,
                      slot,
                      U(i) + lane_index<F>(),
                      invisible ? seen : seen_after<F>(bsdf, s.sample.lobe, seen)};
    uint32_t at = append(out, next, alive);
    if (volumetric)
        append_lanes(out, at,
                     PathMedium<F>{medium_behind(c.scene, si.at.shape, si.ng, d, medium, alive), path_depth + 1u,
                                   lanes(in.channel), dot(o - si.p, d)},
                     alive);
    else if (c.bent)
        append_lanes(out, at,
                     PathMedium<F>{medium_behind(c.scene, si.at.shape, si.ng, d, medium, alive), U(0u),
                                   uniform_spectrum(F(1)), F(0)},
                     alive);
}

template <class F>
TR_LARGE void shade_environment(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                                const LaneSet<F> &lanes, uint32_t i) {
    using U = UIntOf<F>;
    // the emission of a split after the first has been counted
    auto shown = step.split == 0 && c.scene.environment >= 0 ? lanes.active : MaskOf<F>(false);
    if (c.config.volumetric && c.config.hide_emitters) shown = shown && !mask<F>(lanes(in.depth) == U(0u));
    FoundEmission<F> e = no_emission<F>();
    U slot = lanes(in.slot);
    if (any(shown)) {
        PacketSamples<F> samples(c, slot, lanes.active);
        PreviousVertex<F> from{lanes(in.from), lanes(in.pdf)};
        e = environment_emission(c, samples.wavelengths(c.config), lanes(in.d), from, shown, step.depth);
    }
    Spectrum<F> beta = lanes(in.beta);
    if (!c.tape) return add_radiance(c, slot, beta, e, shown, Culprit::Environment);
    write_vertex(c, i, slot_on_tape(c, slot, lanes(in.seen)), lanes(in.parent), beta, e.point.at, e);
    if (c.bent) write(c.tape->bent.medium, i, IntOf<F>(-1));
    if (!c.keeps_arrivals()) return;
    Vec3<F> zero{F(0), F(0), F(0)};
    write_arrival(c, i, lanes(in.d), zero, zero, F(0), arrival_kind<F>(mask<F>(lanes(in.pdf) == F(0))));
}

#define TR_INSTANTIATE(F, S)                                                                                 \
    template ResolvedBsdf<F> resolve_hit(const PathContext<F> &, const PacketSamples<F> &, Interaction<F> &, \
                                         const Vec3<F> &, uint32_t, bool, const MaskOf<F> &);                \
    template void shade_surface(const PathContext<F> &, int, const PathStep &, const PathQueue<S> &,         \
                                const HitColumns<S> &, const LaneSet<F> &, uint32_t, PathQueue<S> &,         \
                                ShadowQueue<S> &);                                                           \
    template void shade_environment(const PathContext<F> &, const PathStep &, const PathQueue<S> &,          \
                                    const LaneSet<F> &, uint32_t);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
