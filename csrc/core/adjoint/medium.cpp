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

}  // namespace

template <class F>
TR_LARGE Spectrum<F> sweep_segment(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Spectrum<F> &delta,
                                   const Spectrum<F> &beta, const Spectrum<F> &r, const Spectrum<F> &branch,
                                   const MediumNeeds &needs, const MaskOf<F> &active, GradientSink<F> &sink) {
    Spectrum<F> total = apply(r, v.weight), none = uniform_spectrum(F(0));
    auto behind_emission = mask<F>(v.emission_behind != UIntOf<F>(0u));
    for_each_distinct<F>(v.medium, active && mask<F>(v.medium >= 0), [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &medium = scene.media[m];
        Spectrum<F> behind = apply(beta, r);
        if (medium.emission >= 0) {
            Spectrum<F> factor = v.emission_factor * v.length;
            Spectrum<F> emitted =
                apply(factor, eval_volume(scene, scene.values, sink.waves, medium.emission, v.emission_p, lanes));
            total = select(lanes, total + emitted, total);
            behind = behind + select(behind_emission, apply(v.first, emitted), none);
            if (needs.emission)
                sink.volume(scene, medium.emission, v.emission_p, pull(pull(delta, v.first), factor), lanes);
        }
        if (needs.extinction)
            sweep_extinction(scene, medium, v.differential_p,
                             apply(delta, v.differential_value + branch - behind) * v.length, lanes, sink);
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
TR_LARGE Spectrum<F> sweep_collision(const SceneOf<F> &scene, const VertexRecord<F> &v, const IntOf<F> &medium,
                                     const Spectrum<F> &a, const Spectrum<F> &next, const GradientNeeds &needs,
                                     const MaskOf<F> &active, GradientSink<F> &sink) {
    Spectrum<F> total = uniform_spectrum(F(0));
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &info = scene.media[m];
        Spectrum<F> albedo = eval_volume(scene, scene.values, sink.waves, info.albedo, v.p, lanes);
        F phase = eval_phase(scene, info.phase, v.p, v.d, v.wo, lanes);
        F phase_light = eval_phase(scene, info.phase, v.p, v.d, v.wo_light, lanes);
        Spectrum<F> light_factor = apply(v.through, v.emitted) * v.light_weight, path_factor = next * v.inverse_pdf;
        Spectrum<F> scattered = light_factor * phase_light + path_factor * phase;
        total = select(lanes, apply(albedo, scattered), total);
        if (needs.medium.albedo) sink.volume(scene, info.albedo, v.p, apply(a, scattered), lanes);
        Spectrum<F> at_phase = pull(a, albedo);
        if (needs.medium.phase) {
            sweep_phase(scene, info.phase, v.p, v.d, v.wo, apply(at_phase, path_factor), lanes, sink);
            sweep_phase(scene, info.phase, v.p, v.d, v.wo_light, apply(at_phase, light_factor), lanes, sink);
        }
        auto lit = lanes && mask<F>(v.light_weight > F(0));
        if (needs.emitter && any(lit)) {
            CoordinateAdjoint<F> at;
            Vec3<F> d_bar{F(0), F(0), F(0)};
            sweep_emitter(scene, v.light, v.wo_light, pull(at_phase, v.through) * (phase_light * v.light_weight), needs,
                          lit, at, d_bar, sink);
        }
    });
    return total;
}

#define TR_INSTANTIATE(F, S)                                                                                \
    template Spectrum<F> sweep_segment(const SceneView<S> &, const SegmentPacket<F> &, const Spectrum<F> &, \
                                       const Spectrum<F> &, const Spectrum<F> &, const Spectrum<F> &,       \
                                       const MediumNeeds &, const MaskOf<F> &, GradientSink<F> &);          \
    template Spectrum<F> sweep_collision(const SceneView<S> &, const VertexRecord<F> &, const IntOf<F> &,   \
                                         const Spectrum<F> &, const Spectrum<F> &, const GradientNeeds &,   \
                                         const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
