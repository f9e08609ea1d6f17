#include "medium.h"

#include "../adjoint/polarized_light.h"

namespace tr {

namespace {

// One scattering in a medium: an emitter sample, and a direction from the phase function.
template <class F>
struct MediumScattering {
    Spectrum<F> albedo = uniform_spectrum(F(0));
    // N = albedo * phase_light * emitted * light_weight * transmittance
    EmitterSample<F> light = no_emitter_sample<F>();
    Spectrum<F> emitted = uniform_spectrum(F(0));
    F phase_light{0}, light_weight{0};
    MaskOf<F> shadow_ray{false};
    Vec3<F> wo{F(0), F(0), F(1)};
    F pdf{1};  // of wo; the value of the phase function
};

template <class F>
TR_INLINE SurfacePoint<F> select_point(const MaskOf<F> &m, const SurfacePoint<F> &a, const SurfacePoint<F> &b) {
    auto u = mask<UIntOf<F>>(m);
    return {select(u, a.shape, b.shape), select(u, a.primitive, b.primitive), select(m, a.b1, b.b1),
            select(m, a.b2, b.b2)};
}

// The emitter sample of a point p that is reached along d: an estimate of light scattered once there, without albedo.
template <class F>
TR_INLINE void sample_light(const PathContext<F> &c, const Wavelengths<F> &waves, const MediumInfo &medium,
                            const Vec3<F> &p, const Vec3<F> &d, const Random4<F> &u, const MaskOf<F> &active,
                            MediumScattering<F> &r) {
    auto some = active && !MaskOf<F>(medium.enclosed != 0);
    if (c.scene.n_emitters == 0 || !any(some)) return;
    EmitterSample<F> light = sample_emitter(c.scene, p, u.u[0], u.u[1], u.u[2], some);
    F phase = eval_phase(c.scene, medium.phase, p, d, light.d, some);
    auto possible = some && mask<F>(light.pdf > F(0));
    F weight = emitter_sample_weight(light, phase, F(1), F(1), possible);
    Spectrum<F> emitted = eval_emitter(c.scene, waves, light.point, possible);
    r.light_weight = select(possible, weight, r.light_weight);
    r.phase_light = select(possible, phase, r.phase_light);
    r.emitted = select(possible, emitted, r.emitted);
    r.light.point.emitter = select(mask<IntOf<F>>(possible), light.point.emitter, r.light.point.emitter);
    r.light.point.at = select_point(possible, light.point.at, r.light.point.at);
    r.light.d = select(possible, light.d, r.light.d);
    r.light.distance = select(possible, light.distance, r.light.distance);
    r.shadow_ray = r.shadow_ray || possible;
}

// Lanes may be in different media.
template <class F>
TR_INLINE MediumScattering<F> scatter(const PathContext<F> &c, const Wavelengths<F> &waves, const IntOf<F> &medium,
                                      const Vec3<F> &p, const Vec3<F> &d, const Random4<F> &u_light,
                                      const Random4<F> &u_phase, const MaskOf<F> &active) {
    MediumScattering<F> r;
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &info = c.scene.media[m];
        r.albedo = select(lanes, eval_volume(c.scene, c.scene.values, waves, info.albedo, p, lanes), r.albedo);
        sample_light(c, waves, info, p, d, u_light, lanes, r);
        Vec3<F> wo = sample_phase(c.scene, info.phase, p, d, u_phase.u[0], u_phase.u[1], u_phase.u[2], lanes);
        r.wo = select(lanes, wo, r.wo);
        r.pdf = select(lanes, eval_phase(c.scene, info.phase, p, d, wo, lanes), r.pdf);
    });
    return r;
}

// Whether emitter samples are taken in these media, so that emission found by chance is weighted against them.
template <class F>
TR_INLINE MaskOf<F> samples_lights(const SceneOf<F> &scene, const IntOf<F> &medium, const MaskOf<F> &active) {
    MaskOf<F> r(false);
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        if (!scene.media[m].enclosed) r = r || lanes;
    });
    return r;
}

template <class F>
TR_INLINE void push_light_ray(const Vec3<F> &p, const EmitterSample<F> &light, const Spectrum<F> &contribution,
                              const IntOf<F> &medium, const UIntOf<F> &slot, uint32_t i, ShadowPurpose purpose,
                              const MaskOf<F> &wanted, ShadowQueue<ScalarOf<F>> &shadows) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    if (!any(wanted)) return;
    auto near = mask<F>(light.distance < F(S(1e30)));
    F length = select(near, light.distance * F(1 - ShadowEpsilon), F(S(INFINITY)));
    uint32_t at = append(shadows, ShadowRay<F>{p, light.d, length, slot, U(i) + lane_index<F>()}, wanted);
    append_lanes(shadows, at, ShadowValue<F>{contribution}, wanted);
    append_lanes(shadows, at, ShadowMedium<F>{medium, F(0), U(uint32_t(purpose))}, wanted);
}

}  // namespace

// ------------------------------------------------------------------------------------------------------- free flight
template <class F>
TR_LARGE void begin_media(const PathContext<F> &c, PathQueue<ScalarOf<F>> &queue, uint32_t i) {
    int32_t medium = camera_medium(c.scene.sensors[c.config.sensor]);
    write(queue, i, PathMedium<F>{IntOf<F>(medium), UIntOf<F>(0u), uniform_spectrum(F(1)), F(0)});
}

template <class F>
TR_LARGE void begin_media_slots(const PathContext<F> &c, const MediumContext<F> &m, uint32_t i) {
    using U = UIntOf<F>;
    Entries<F> from(i);
    auto u = random4<F>(c.config.seed, c.config.sensor, from(c.slots.pixel), from(c.slots.sample), ChannelBlock);
    write(m.branch.hero, i, U(IntOf<F>(u.u[0] * F(SpectrumSize))));
    write(m.branch.total_weight, i, F(0));
    write(m.branch.level, i, U(NoLevel));
    const Spectrum<F> none = uniform_spectrum(F(0));
    write(m.branch.radiance, i, none);
    if (!c.config.stokes) return;
    write(m.branch.q, i, none), write(m.branch.u, i, none), write(m.branch.v, i, none);
    write(m.branch.axis, i, Vec3<F>{F(0), F(0), F(0)});
}

template <class F>
TR_LARGE void begin_flight(const PathContext<F> &c, const MediumContext<F> &m, const PathQueue<ScalarOf<F>> &queue,
                           const HitColumns<ScalarOf<F>> &hits, uint32_t i) {
    using U = UIntOf<F>;
    Entries<F> from(i);
    const auto &flight = m.flight;
    auto active = mask<F>(U(i) + lane_index<F>() < U(queue.n));
    auto missed = mask<F>(from.get(hits.at.shape) == U(NoHit));
    write(flight.end, i, select(missed, from(queue.length), from(hits.t)));
    if (c.needs->geometry) write(flight.behind, i, from.get(hits.at.shape));
    write(flight.start, i, F(0));
    write(flight.length, i, F(0));
    write(flight.collided, i, U(0u));
    if (m.chromatic)  // grey media do not write them
        for (const auto *weight : {&flight.weight, &flight.differential_weight, &flight.emission_weight})
            write(*weight, i, uniform_spectrum(F(1)));
    auto inside = active && mask<F>(from(queue.medium) >= 0);
    if (!any(inside)) return;
    LaneSet<F> lanes(select(mask<U>(active), from(queue.slot), U(0u)), active);
    auto random = random_bits4<F>(c.config.seed, c.config.sensor, lanes(c.slots.pixel), lanes(c.slots.sample),
                                  U(SegmentBlock + BlocksPerSegment * m.level));
    write(flight.seed_a, i, random.bits[0] | U(1u));
    write(flight.seed_b, i, random.bits[1]);
    write(flight.choice, i, uniform_of<F>(random.bits[2]));
    if (m.chromatic) write(flight.hero, i, lanes(m.branch.hero));
}

namespace {

// Spectral MIS: throughput and the densities of the components after the segment, whose mean stays one.
template <class F>
TR_INLINE void weigh_components(const MediumContext<F> &m, bool stokes, PathQueue<ScalarOf<F>> &queue, uint32_t i) {
    Entries<F> from(i);
    const auto &flight = m.flight;
    auto inside = mask<F>(from(queue.medium) >= 0);
    Spectrum<F> p = from(queue.channel), beta = from(queue.beta), survival = from(queue.survival), w;
    write(flight.first, i, beta);
    auto ratio = [&](const SpectrumColumn<ScalarOf<F>> &column) {
        F mean(0);
        Spectrum<F> given = from(column);
        for (int k = 0; k < SpectrumSize; ++k) {
            w[k] = select(inside, given[k], F(1));
            mean = fmadd(p[k], w[k], mean);
        }
        return F(SpectrumSize) / mean;
    };
    F scale = ratio(flight.weight);
    Spectrum<F> factor = select(inside, w * scale, uniform_spectrum(F(1)));
    write(flight.weight, i, factor);
    write(queue.beta, i, beta * factor);
    write(queue.survival, i, survival * factor);
    write(queue.channel, i, p * factor);
    if (!m.keeps_points()) return;
    scale = ratio(flight.differential_weight);
    write(flight.differential_weight, i, (stokes ? w : beta * w) * scale);
    write(flight.differential_channel, i, p * w * scale);
    scale = ratio(flight.emission_weight);
    write(flight.emission_weight, i, w * scale);
}

template <class F>
TR_INLINE void add_emission(const PathContext<F> &c, const MediumContext<F> &m, const PathQueue<ScalarOf<F>> &queue,
                            uint32_t i) {
    using U = UIntOf<F>;
    Entries<F> from(i);
    F length = from(m.flight.length);
    IntOf<F> medium = from(queue.medium);
    auto active = mask<F>(U(i) + lane_index<F>() < U(queue.n)) && mask<F>(medium >= 0) && mask<F>(length > F(0));
    Wavelengths<F> waves = PacketSamples<F>(c, from(queue.slot), active).wavelengths(c.config);
    for_each_distinct<F>(medium, active, [&](int32_t k, const MaskOf<F> &same) {
        const MediumInfo &info = c.scene.media[k];
        if (info.emission < 0) return;
        Vec3<F> p = from(queue.o) + from(queue.d) * from(m.flight.emission);
        Spectrum<F> r = eval_volume(c.scene, c.scene.values, waves, info.emission, p, same) * length;
        r = r * (m.chromatic ? from(m.flight.first) * from(m.flight.emission_weight) : from(queue.beta));
        add_to_entries<F>(c.slots.radiance, from(queue.slot), r, same);
    });
}

}  // namespace

template <class F>
TR_LARGE void finish_flight(const PathContext<F> &c, const MediumContext<F> &m, PathQueue<ScalarOf<F>> &queue,
                            const HitColumns<ScalarOf<F>> &hits, bool add_radiance, uint32_t i) {
    using U = UIntOf<F>;
    Entries<F> from(i);
    auto collided = mask<F>(from(m.flight.collided) != U(0u));
    store(hits.at.shape + i, select(mask<U>(collided), U(MediumHit), from.get(hits.at.shape)));
    write(hits.t, i, select(collided, from(m.flight.start) + from(m.flight.length), from(hits.t)));
    if (m.chromatic) weigh_components(m, c.config.stokes, queue, i);
    if (m.emissive && add_radiance) add_emission(c, m, queue, i);
}

// -------------------------------------------------------------------------------------------------------- collisions
template <class F>
TR_LARGE void shade_medium(const PathContext<F> &c, const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                           const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                           PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &shadows) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    const PathConfig &config = c.config;
    Vec3<F> d = lanes(in.d), p = lanes(in.o) + d * lanes(hits.t);
    I medium = lanes(in.medium);
    U slot = lanes(in.slot), path_depth = lanes(in.depth);
    Spectrum<F> beta = lanes(in.beta);
    if (c.tape) {
        FoundEmission<F> none = no_emission<F>();
        write_vertex(c, i, slot, lanes(in.parent), beta, none.point.at, none);
        auto chosen = !mask<F>(lanes(in.pdf) == F(0));
        write_arrival(c, i, d, p, Vec3<F>{F(0), F(0), F(0)}, lanes(hits.t),
                      select(mask<U>(chosen), U(uint32_t(Resting)), U(uint32_t(Attached))));
    } else {
        mark_seen(c, slot, lanes(in.seen), lanes.active);
    }
    auto may = lanes.active && may_scatter<F>(config, path_depth);
    PacketSamples<F> samples(c, slot, lanes.active);
    const uint32_t block = BlocksPerScattering * uint32_t(step.depth);
    Random4<F> u_light = samples.draw(EmitterBlock + block, AllWanted);
    Random4<F> u_phase = samples.draw(BsdfBlock + block, PairWanted | ThirdWanted);
    MediumScattering<F> s = scatter(c, samples.wavelengths(config), medium, p, d, u_light, u_phase, may);
    Spectrum<F> contribution = apply(pull(beta, s.albedo), s.emitted) * (s.phase_light * s.light_weight);
    auto lit = s.shadow_ray && finite(c, contribution, s.shadow_ray, Culprit::Medium, medium);
    s.light_weight = select(lit, s.light_weight, F(0));
    if (!c.tape) lit = lit && mask<F>(max_component(contribution) > F(0));
    push_light_ray(p, s.light, contribution, medium, slot, i, ShadowPurpose::Vertex, lit, shadows);

    const bool differentiated = c.tape && c.needs->medium.albedo;
    Spectrum<F> survival = lanes(in.survival) * (differentiated ? kept_factor(s.albedo, MaskOf<F>(true)) : s.albedo);
    F eta = lanes(in.eta), throughput = max_component(survival), keep(1);
    auto alive = may && mask<F>(throughput > F(0));
    auto counted = alive && mask<F>(I(path_depth) + 1 >= I(config.rr_depth));
    if (any(counted)) keep = play_roulette(throughput, eta, u_light.u[3], counted, alive);
    if (c.tape)
        write(c.tape->outgoing, i,
              OutgoingPacket<F>{s.light.point.emitter, s.light.point.at, s.light.d, s.light_weight, s.light.distance,
                                s.emitted, s.wo, I(0), select(alive, keep / select(alive, s.pdf, F(1)), F(0))});
    if (!any(alive)) return;
    auto weighted = samples_lights<F>(c.scene, medium, alive);
    PathState<F> next{p,
                      s.wo,
                      F(S(INFINITY)),
                      p,
                      select(weighted, s.pdf, F(0)),
                      pull(beta, s.albedo) * keep,
                      eta,
                      survival * keep,
                      slot,
                      U(i) + lane_index<F>(),
                      lanes(in.seen) | SeenSomething};
    uint32_t at = append(out, next, alive);
    append_lanes(out, at, PathMedium<F>{medium, path_depth + 1u, lanes(in.channel), F(0)}, alive);
}

template <class F>
TR_LARGE void pass_boundary(const PathContext<F> &c, const PathQueue<ScalarOf<F>> &in,
                            const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                            const Interaction<F> &si, PathQueue<ScalarOf<F>> &out) {
    Vec3<F> d = lanes(in.d);
    F length = lanes(in.length) - lanes(hits.t);
    auto on = lanes.active && mask<F>(length > F(0));
    if (c.tape) write(c.tape->outgoing.inverse_pdf, i, select(on, F(1), F(0)));
    if (!any(on)) return;
    const F ahead = offset_along(si.p, si.ng, d);
    PathState<F> next{lanes(in.o) + d * (lanes(hits.t) + ahead),
                      d,
                      length,
                      lanes(in.from),
                      lanes(in.pdf),
                      lanes(in.beta),
                      lanes(in.eta),
                      lanes(in.survival),
                      lanes(in.slot),
                      UIntOf<F>(i) + lane_index<F>(),
                      lanes(in.seen)};
    uint32_t at = append(out, next, on);
    append_lanes(out, at,
                 PathMedium<F>{medium_behind(c.scene, si.at.shape, si.ng, d, lanes(in.medium), on), lanes(in.depth),
                               lanes(in.channel), ahead},
                 on);
}

// ---------------------------------------------------------------------------------------------- segments on the tape
namespace {

// Where the ends of the segment are, and where its points.
template <class F>
TR_INLINE void write_motion(const PathContext<F> &c, const MediumContext<F> &m, const PathStep &step,
                            const PathQueue<ScalarOf<F>> &in, const HitColumns<ScalarOf<F>> &hits,
                            const LaneSet<F> &lanes, uint32_t i) {
    Vec3<F> o = lanes(in.o), d = lanes(in.d), zero{F(0), F(0), F(0)};
    // from where the ray comes: a camera's may begin at a near plane, others begin beside surfaces
    F ahead = step.depth == 0 ? dot(o - lanes(in.from), d) : lanes(in.ray_offset);
    SurfacePoint<F> none{UIntOf<F>(NoHit), UIntOf<F>(0u), F(0), F(0)}, end = lanes(hits.at);
    end.shape = lanes(m.flight.behind);
    write(c.tape->motion, i,
          MotionPacket<F>{o - d * ahead, step.depth == 0 ? ahead : F(0), end, lanes(m.flight.end) + ahead,
                          lanes(m.flight.differential) + ahead, lanes(m.flight.emission) + ahead, lanes(hits.t) + ahead,
                          zero, none, none, F(0), F(0), F(0), zero, zero});
}

// One of a path's segments, drawn in proportion to `weight` as they come by. `beta`: the throughput, of which `factor`
// is the part since the segment's beginning.
template <class F>
TR_INLINE void choose_branch(const MediumContext<F> &m, const PathQueue<ScalarOf<F>> &in, const LaneSet<F> &lanes,
                             uint32_t i, const Vec3<F> &p, const Vec3<F> &d, const F &weight, const Spectrum<F> &beta,
                             const Spectrum<F> &factor, const MaskOf<F> &may) {
    using U = UIntOf<F>;
    if (m.replaying) return;  // chosen when the path was traced first
    auto some = may && mask<F>(weight > F(0));
    if (!any(some)) return;
    const auto &branch = m.branch;
    U slot = lanes(in.slot);
    F total = Gathered<F>(slot, some)(branch.total_weight) + weight;
    scatter_lanes<F>(branch.total_weight.at, slot, total, some);
    auto chosen = some && mask<F>(lanes(m.flight.choice) * total < weight);
    if (!any(chosen)) return;
    F drawn = select(chosen, weight, F(1));
    Spectrum<F> channel = m.chromatic ? lanes(m.flight.differential_channel) : uniform_spectrum(F(1));
    auto put = [&](auto *column, const auto &value) { scatter_lanes<F>(column, slot, value, chosen); };
    put(branch.level.at, U(m.level));
    put(branch.entry.at, U(i) + lane_index<F>());
    put(branch.medium.at, lanes(in.medium));
    put(branch.depth.at, lanes(in.depth) + 1u);
    put(branch.p.x, p.x), put(branch.p.y, p.y), put(branch.p.z, p.z);
    put(branch.d.x, d.x), put(branch.d.y, d.y), put(branch.d.z, d.z);
    for (int k = 0; k < SpectrumSize; ++k) {
        // times the total weight, which is known at the end
        put(branch.beta[k], beta[k] / drawn), put(branch.factor[k], factor[k] / drawn);
        put(branch.channel[k], channel[k]);
    }
}

}  // namespace

template <class F>
TR_LARGE void record_segment(const PathContext<F> &c, const MediumContext<F> &m, const PathStep &step,
                             const PathQueue<ScalarOf<F>> &in, const HitColumns<ScalarOf<F>> &hits,
                             const LaneSet<F> &lanes, uint32_t i, ShadowQueue<ScalarOf<F>> &shadows) {
    using I = IntOf<F>;
    const auto &tape = c.tape->segment;
    I medium = lanes(in.medium);
    auto inside = lanes.active && mask<F>(medium >= 0);
    Spectrum<F> zero = uniform_spectrum(F(0)), one = uniform_spectrum(F(1)), beta = lanes(in.beta);
    Vec3<F> origin{F(0), F(0), F(0)};
    SegmentPacket<F> segment;
    // a segment may have no length and end with a collision all the same
    segment.medium = select(mask<I>(inside), medium, I(-1));
    segment.length = lanes(m.flight.length);
    segment.weight = m.chromatic ? lanes(m.flight.weight) : one;
    segment.through = one;
    segment.shadow_medium = I(-1);
    segment.shadow_length = F(0);
    segment.shadow_value = segment.differential_value = segment.first = segment.emission_factor = zero;
    segment.differential_p = segment.shadow_p = segment.emission_p = origin;
    segment.emission_behind = UIntOf<F>(0u);
    inside = inside && mask<F>(segment.length > F(0));
    Vec3<F> o = lanes(in.o), d = lanes(in.d);
    F differential = lanes(m.flight.differential);
    const bool some = any(inside);
    if (c.needs->geometry) write_motion(c, m, step, in, hits, lanes, i);
    if (some && m.emissive) {
        F emission = lanes(m.flight.emission);
        segment.emission_p = o + d * emission;
        segment.emission_behind =
            select(mask<UIntOf<F>>(mask<F>(emission > differential)), UIntOf<F>(1u), UIntOf<F>(0u));
        segment.emission_factor = m.chromatic ? lanes(m.flight.emission_weight) : one;
        segment.first = m.chromatic ? lanes(m.flight.first) : beta;
    }
    Vec3<F> p = o + d * differential;
    if (some && m.differential) segment.differential_p = p;
    write(tape, i, segment);
    if (!some || !m.differential) return;

    auto may = inside && may_scatter<F>(c.config, lanes(in.depth));
    if (!any(may)) return;
    if (m.chromatic) beta = lanes(m.flight.differential_weight);
    UIntOf<F> slot = lanes(in.slot);
    PacketSamples<F> samples(c, slot, lanes.active);
    Wavelengths<F> waves = samples.wavelengths(c.config);
    Random4<F> u_light =
        samples.draw(EmitterBlock + BlocksPerScattering * uint32_t(step.depth), PairWanted | ThirdWanted);
    MediumScattering<F> s;
    for_each_distinct<F>(medium, may, [&](int32_t k, const MaskOf<F> &same) {
        const MediumInfo &info = c.scene.media[k];
        s.albedo = select(same, eval_volume(c.scene, c.scene.values, waves, info.albedo, p, same), s.albedo);
        sample_light(c, waves, info, p, d, u_light, same, s);
    });
    Spectrum<F> scattered = pull(beta, s.albedo), recorded = scattered;
    if (c.config.stokes) {  // a row of the sweep takes the place of the throughput at the segment's beginning
        recorded = s.albedo;
        if (m.chromatic) recorded = scattered, scattered = lanes(m.flight.first) * scattered;
        write(c.tape->stokes.differential_light, i, s.light.d);
        if (c.scene.polarized_lights) {
            const PolarizedLight<F> lamp(c.scene, s.light.point, may && mask<F>(s.light_weight > F(0)));
            write(c.tape->stokes.differential_shares, i, lamp.shares);
            write(c.tape->stokes.differential_axis, i, lamp.axis);
        }
    }
    Spectrum<F> contribution = apply(recorded, s.emitted) * (s.phase_light * s.light_weight);
    auto lit = s.shadow_ray && is_finite(contribution) && mask<F>(max_component(contribution) > F(0));
    push_light_ray(p, s.light, contribution, medium, slot, i, ShadowPurpose::Differential, lit, shadows);
    choose_branch(m, in, lanes, i, p, d, segment.length * max_component(scattered), scattered, recorded, may);
}

template <class F>
TR_LARGE void start_branches(const PathContext<F> &c, const MediumContext<F> &m, uint32_t i, uint32_t n_slots,
                             PathQueue<ScalarOf<F>> &out) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    Entries<F> from(i);
    const auto &branch = m.branch;
    U slot = U(i) + lane_index<F>();
    auto active = mask<F>(slot < U(n_slots)) && !mask<F>(from(branch.level) == U(NoLevel));
    if (!any(active)) return;
    Vec3<F> p = from(branch.p), d = from(branch.d), wo = d;
    F pdf(0);
    const PathNumbers<F> numbers(c.config, from(c.slots.pixel), from(c.slots.sample));
    Random4<F> u = numbers.draw(BsdfBlock + BlocksPerScattering * (BranchLevel - 1), PairWanted | ThirdWanted);
    for_each_distinct<F>(from(branch.medium), active, [&](int32_t k, const MaskOf<F> &same) {
        const MediumInfo &info = c.scene.media[k];
        wo = select(same, sample_phase(c.scene, info.phase, p, d, u.u[0], u.u[1], u.u[2], same), wo);
        if (!info.enclosed) pdf = select(same, eval_phase(c.scene, info.phase, p, d, wo, same), pdf);
    });
    const F total = from(branch.total_weight);
    Spectrum<F> beta = from(branch.beta) * total;
    if (c.config.stokes) write(branch.wo, i, wo), write(branch.factor, i, from(branch.factor) * total);
    uint32_t at =
        append(out, PathState<F>{p, wo, F(S(INFINITY)), p, pdf, beta, F(1), beta, slot, U(0u), U(1u)}, active);
    append_lanes(out, at, PathMedium<F>{from(branch.medium), from(branch.depth), from(branch.channel), F(0)}, active);
}

#define TR_INSTANTIATE(F, S)                                                                                          \
    template void begin_media(const PathContext<F> &, PathQueue<S> &, uint32_t);                                      \
    template void begin_media_slots(const PathContext<F> &, const MediumContext<F> &, uint32_t);                      \
    template void begin_flight(const PathContext<F> &, const MediumContext<F> &, const PathQueue<S> &,                \
                               const HitColumns<S> &, uint32_t);                                                      \
    template void finish_flight(const PathContext<F> &, const MediumContext<F> &, PathQueue<S> &,                     \
                                const HitColumns<S> &, bool, uint32_t);                                               \
    template void shade_medium(const PathContext<F> &, const PathStep &, const PathQueue<S> &, const HitColumns<S> &, \
                               const LaneSet<F> &, uint32_t, PathQueue<S> &, ShadowQueue<S> &);                       \
    template void pass_boundary(const PathContext<F> &, const PathQueue<S> &, const HitColumns<S> &,                  \
                                const LaneSet<F> &, uint32_t, const Interaction<F> &, PathQueue<S> &);                \
    template void record_segment(const PathContext<F> &, const MediumContext<F> &, const PathStep &,                  \
                                 const PathQueue<S> &, const HitColumns<S> &, const LaneSet<F> &, uint32_t,           \
                                 ShadowQueue<S> &);                                                                   \
    template void start_branches(const PathContext<F> &, const MediumContext<F> &, uint32_t, uint32_t, PathQueue<S> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
