#include "medium.h"

#include "scattering.h"

namespace tr {

namespace {

template <class F>
TR_INLINE void sweep_extinction(const SceneOf<F> &scene, const MediumInfo &medium, const Vec3<F> &p,
                                const Spectrum<F> &g, MaskOf<F> active, GradientSink<F> &sink) {
    if (medium.flags & IsGrid) active = active && inside_grid(scene, medium, p);
    if (!any(active)) return;
    sink.volume(scene, medium.extinction, p, g * F(scene.values.constants[medium.scale]), active);
    Spectrum<F> extinction = eval_volume(scene, scene.values, sink.waves, medium.extinction, p, active);
    sink.number(IntOf<F>(medium.scale), apply(g, extinction), active);
}

// Adjoints at the points of a segment, which the motion of both its ends turns into those of a line.
template <class F>
TR_INLINE void sweep_motion(const SceneOf<F> &scene, const MediumInfo &medium, const SegmentPacket<F> &v,
                            const Spectrum<F> &rest_bar, const Spectrum<F> &glued_bar, const Spectrum<F> &emission_bar,
                            const MaskOf<F> &lanes, SegmentMotion<F> &m, GradientSink<F> &sink) {
    const MotionPacket<F> &at = m.at;
    const F scale(scene.values.constants[medium.scale]);
    SurfacePoint<F> line = at.end_at;
    line.shape = UIntOf<F>(NoHit);
    auto longer = lanes && mask<F>(v.length > F(0));
    auto extinction = [&](PartSweep<F> &part, const Spectrum<F> &g, const MaskOf<F> &some) {
        Spectrum<F> sigma = eval_volume(scene, scene.values, sink.waves, medium.extinction, v.differential_p, some);
        part.add_lookup(medium.extinction, at.differential_t, g * scale, contract(g * scale, sigma), some, sink);
    };
    MediumPart<F> part{line, at.end_at, at.ahead, at.reach};
    PartSweep<F> rest(scene, medium, at.line, m.d, part, lanes);
    if (any(longer)) extinction(rest, rest_bar, longer);
    if (medium.emission >= 0 && any(longer)) {
        Spectrum<F> value = eval_volume(scene, scene.values, sink.waves, medium.emission, v.emission_p, longer);
        rest.add_lookup(medium.emission, at.emission_t, emission_bar, contract(emission_bar, value), longer, sink);
    }
    auto collided = lanes && m.collided;
    if (any(collided)) rest.add(at.stop_t, select(collided, m.collision_bar, Vec3<F>{F(0), F(0), F(0)}), F(0));
    rest.hand_to(m.rest, sink);
    auto seen = longer && m.seen_from_glued;
    if (!any(seen)) return;
    // a glued point ends the line; boundaries before it slide
    part.to.shape = select(mask<UIntOf<F>>(m.ends_glued), line.shape, part.to.shape);
    PartSweep<F> glued(scene, medium, at.line, m.d, part, seen);
    extinction(glued, glued_bar, seen);
    glued.hand_to(m.glued, sink);
}

}  // namespace

template <class F>
TR_LARGE Spectrum<F> sweep_segment(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Spectrum<F> &delta,
                                   const Spectrum<F> &beta, const Spectrum<F> &r, const Spectrum<F> &branch,
                                   const MediumNeeds &needs, const MaskOf<F> &active, GradientSink<F> &sink,
                                   SegmentMotion<F> *motion) {
    Spectrum<F> total = apply(r, v.weight), none = uniform_spectrum(F(0));
    auto behind_emission = mask<F>(v.emission_behind != UIntOf<F>(0u));
    for_each_distinct<F>(v.medium, active && mask<F>(v.medium >= 0), [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &medium = scene.media[m];
        // light on its way through the differential sample: from the segment's end, and from its emission
        Spectrum<F> behind = apply(beta, r), along = none, emission_bar = none;
        if (medium.emission >= 0) {
            Spectrum<F> factor = v.emission_factor * v.length;
            Spectrum<F> emitted =
                apply(factor, eval_volume(scene, scene.values, sink.waves, medium.emission, v.emission_p, lanes));
            total = select(lanes, total + emitted, total);
            along = select(behind_emission, apply(v.first, emitted), none);
            emission_bar = pull(pull(delta, v.first), factor);
            if (needs.emission) sink.volume(scene, medium.emission, v.emission_p, emission_bar, lanes);
        }
        if (needs.extinction)
            sweep_extinction(scene, medium, v.differential_p,
                             apply(delta, v.differential_value + branch - behind - along) * v.length, lanes, sink);
        if (!motion) return;
        Spectrum<F> glued_bar = apply(delta, behind) * (-v.length);
        Spectrum<F> rest_bar = apply(delta, v.differential_value + branch - along) * v.length;
        rest_bar = select(motion->seen_from_glued, rest_bar, rest_bar + glued_bar);
        sweep_motion(scene, medium, v, rest_bar, glued_bar, emission_bar, lanes, *motion, sink);
    });
    if (!needs.extinction) return total;
    auto shadowed = active && mask<F>(v.shadow_medium >= 0) && mask<F>(v.shadow_length > F(0));
    for_each_distinct<F>(v.shadow_medium, shadowed, [&](int32_t m, const MaskOf<F> &lanes) {
        sweep_extinction(scene, scene.media[m], v.shadow_p, apply(delta, v.shadow_value) * (-v.shadow_length), lanes,
                         sink);
    });
    return total;
}

template <class F>
TR_LARGE LineAdjoint<F> sweep_shadow_motion(const SceneOf<F> &scene, const SegmentPacket<F> &v,
                                            const MotionPacket<F> &motion, const Vec3<F> &p, const Spectrum<F> &delta,
                                            const MaskOf<F> &active, GradientSink<F> &sink) {
    LineAdjoint<F> line;
    auto shadowed = active && mask<F>(v.shadow_medium >= 0) && mask<F>(v.shadow_length > F(0));
    for_each_distinct<F>(v.shadow_medium, shadowed, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &medium = scene.media[m];
        Spectrum<F> g = apply(delta, v.shadow_value) * (v.shadow_length * F(-scene.values.constants[medium.scale]));
        Spectrum<F> sigma = eval_volume(scene, scene.values, sink.waves, medium.extinction, v.shadow_p, lanes);
        PartSweep<F> part(scene, medium, p, motion.shadow_d,
                          {motion.shadow_from, motion.shadow_to, motion.shadow_t0, motion.shadow_t1}, lanes);
        part.add_lookup(medium.extinction, motion.shadow_t, g, contract(g, sigma), lanes, sink);
        part.hand_to(line, sink);
    });
    return line;
}

template <class F>
TR_LARGE Spectrum<F> sweep_collision(const SceneOf<F> &scene, const VertexRecord<F> &v, const IntOf<F> &medium,
                                     const Spectrum<F> &a, const NextVertex<F> &next, const GradientNeeds &needs,
                                     const MaskOf<F> &active, Vec3<F> &p_bar, Vec3<F> &d_bar, GradientSink<F> &sink,
                                     const PolarizedScattering<F> *polarized) {
    Spectrum<F> total = uniform_spectrum(F(0));
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &info = scene.media[m];
        Spectrum<F> albedo = eval_volume(scene, scene.values, sink.waves, info.albedo, v.p, lanes);
        F phase = eval_phase(scene, info.phase, v.p, v.d, v.wo, lanes);
        F phase_light = eval_phase(scene, info.phase, v.p, v.d, v.wo_light, lanes);
        Spectrum<F> light_factor = apply(v.through, v.emitted) * v.light_weight;
        Spectrum<F> path_factor = next.radiance * v.inverse_pdf;
        Spectrum<F> scattered = light_factor * phase_light + path_factor * phase;
        if (polarized) scattered = scattered + polarized->path + polarized->light;
        total = select(lanes, apply(albedo, scattered), total);
        if (needs.medium.albedo) sink.volume(scene, info.albedo, v.p, apply(a, scattered), lanes);
        Spectrum<F> at_phase = pull(a, albedo);
        if (needs.medium.phase) {
            sweep_phase(scene, info.phase, v.p, v.d, v.wo, apply(at_phase, path_factor), lanes, sink);
            sweep_phase(scene, info.phase, v.p, v.d, v.wo_light, apply(at_phase, light_factor), lanes, sink);
        }
        auto lit = lanes && mask<F>(v.light_weight > F(0));
        CoordinateAdjoint<F> light_at;
        Vec3<F> to_light{F(0), F(0), F(0)};  // adjoint of the direction
        if ((needs.emitter || needs.numbers()) && any(lit)) {
            Spectrum<F> g = pull(at_phase, v.through) * (phase_light * v.light_weight);
            if (polarized) g = g + pull(at_phase, polarized->emitted);
            sweep_emitter(scene, v.light, v.wo_light, g, needs, lit, light_at, to_light, sink);
        }
        if (!needs.numbers()) return;

        Vec3<F> p = next.ray.o;
        F path_bar = contract(at_phase, path_factor), light_bar = contract(at_phase, light_factor);
        F turned = path_bar * phase_slope(scene, info.phase, v.p, v.d, v.wo, path_bar, lanes, p, sink);
        Vec3<F> D_bar = direction_adjoint(next.segment, v.d * turned + next.ray.d), direction = v.wo * turned;
        auto glued = lanes && mask<F>(squared_norm(next.segment) > F(0));
        if (any(glued)) sweep_position(scene, next.at, next.p, D_bar, glued, sink);
        p = p - D_bar;
        p = p + sweep_volume_place(scene, info.albedo, v.p, apply(a, scattered), lanes, sink);
        if (any(lit)) {
            turned = light_bar * phase_slope(scene, info.phase, v.p, v.d, v.wo_light, light_bar, lit, p, sink);
            direction = direction + v.wo_light * turned;
            F brought = light_bar * phase_light;
            if (polarized) brought = brought + contract(at_phase, polarized->light);
            DirectAdjoint<F> g{v.light, v.p,      v.wo_light,     v.light_distance, to_light + v.d * turned + v.way.d,
                               brought, light_at, needs.geometry, v.way.end};
            p = select(lit, p + v.way.o + sweep_direct(scene, g, lit, sink), p);
        }
        p_bar = select(lanes, p_bar + p, p_bar);
        d_bar = select(lanes, d_bar + direction, d_bar);
    });
    return total;
}

#define TR_INSTANTIATE(F, S)                                                                                           \
    template Spectrum<F> sweep_segment(const SceneView<S> &, const SegmentPacket<F> &, const Spectrum<F> &,            \
                                       const Spectrum<F> &, const Spectrum<F> &, const Spectrum<F> &,                  \
                                       const MediumNeeds &, const MaskOf<F> &, GradientSink<F> &, SegmentMotion<F> *); \
    template LineAdjoint<F> sweep_shadow_motion(const SceneView<S> &, const SegmentPacket<F> &,                        \
                                                const MotionPacket<F> &, const Vec3<F> &, const Spectrum<F> &,         \
                                                const MaskOf<F> &, GradientSink<F> &);                                 \
    template Spectrum<F> sweep_collision(const SceneView<S> &, const VertexRecord<F> &, const IntOf<F> &,              \
                                         const Spectrum<F> &, const NextVertex<F> &, const GradientNeeds &,            \
                                         const MaskOf<F> &, Vec3<F> &, Vec3<F> &, GradientSink<F> &,                   \
                                         const PolarizedScattering<F> *);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
