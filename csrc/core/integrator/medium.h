// Scattering in a medium: what happens where a ray has collided. The counterpart of path.h for points in space.
#pragma once

#include "../medium/tracking.h"
#include "path.h"

namespace tr {

// Random numbers of volumetric paths: blocks far from those of path.h, `BlocksPerSegment` a segment. The first one
// seeds free flight (two words) and holds the number by which a segment is chosen for the derivative; the others seed
// the shadow rays of the segment's end and of its probe. One block a path chooses the channel that distances are
// sampled for.
constexpr uint32_t ChannelBlock = 0x3FFFFFFFu, SegmentBlock = 0x40000000u, BlocksPerSegment = 3;
// The path that continues from a probe, which a derivative needs, is numbered like segments that no path reaches.
constexpr uint32_t BranchLevel = 0x00100000u;

enum class ShadowPurpose : uint32_t { Vertex = 0, Probe = 1 };

// The medium behind a surface, for a ray that leaves it along d.
template <class F, class S>
TR_INLINE IntOf<F> medium_behind(const SceneView<S> &scene, const UIntOf<F> &shape, const Vec3<F> &ng, const Vec3<F> &d,
                                 const IntOf<F> &current, const MaskOf<F> &active) {
    using I = IntOf<F>;
    I sides[2];
    gather_few_rows<F>(&scene.shapes->interior, shape * 16u, active, sides);
    auto boundary = active && (mask<F>(sides[0] >= 0) || mask<F>(sides[1] >= 0));
    I next = select(mask<I>(dot(ng, d) > F(0)), sides[1], sides[0]);
    return select(mask<I>(boundary), next, current);
}

// One scattering in a medium: an emitter sample, and a direction from the phase function.
template <class F, int C>
struct MediumScattering {
    Color<F, C> albedo;
    EmitterSample<F> light;
    Color<F, C> emitted;
    F phase_light, light_weight;  // N = albedo * phase_light * emitted * light_weight * transmittance
    MaskOf<F> shadow_ray;
    Vec3<F> wo;
    F pdf;  // of wo; the value of the phase function
};

// The emitter sample of a point p that is reached along d: an estimate of light scattered once there, without albedo.
template <int C, class F, class S>
TR_INLINE void sample_light(const SceneView<S> &scene, const MediumInfo &medium, const Vec3<F> &p, const Vec3<F> &d,
                            const Random4<F> &u, const MaskOf<F> &active, MediumScattering<F, C> &r) {
    auto some = active && !MaskOf<F>(medium.enclosed != 0);
    if (scene.n_emitters == 0 || !any(some)) return;
    EmitterSample<F> light = sample_emitter(scene, p, u.u[0], u.u[1], u.u[2], some);
    F phase = eval_phase(scene, medium.phase, p, d, light.d, some);
    auto possible = some && mask<F>(light.pdf > F(0));
    F weight = select(light.delta, F(1), power_heuristic(light.pdf, phase));
    Color<F, C> emitted = eval_emitter<C>(scene, light.point, possible);
    r.light_weight = select(possible, weight * light.factor / select(possible, light.pdf, F(1)), r.light_weight);
    r.phase_light = select(possible, phase, r.phase_light);
    r.emitted = select(possible, emitted, r.emitted);
    auto possible_i = mask<IntOf<F>>(possible);
    auto possible_u = mask<UIntOf<F>>(possible);
    SurfacePoint<F> &to = r.light.point.at;
    const SurfacePoint<F> &at = light.point.at;
    r.light.point.emitter = select(possible_i, light.point.emitter, r.light.point.emitter);
    to.shape = select(possible_u, at.shape, to.shape);
    to.primitive = select(possible_u, at.primitive, to.primitive);
    to.b1 = select(possible, at.b1, to.b1);
    to.b2 = select(possible, at.b2, to.b2);
    r.light.d = select(possible, light.d, r.light.d);
    r.light.distance = select(possible, light.distance, r.light.distance);
    r.shadow_ray = r.shadow_ray || possible;
}

template <int C, class F>
TR_INLINE MediumScattering<F, C> no_medium_scattering() {
    MediumScattering<F, C> r;
    r.light = no_emitter_sample<F>();
    r.albedo = r.emitted = uniform_color<C>(F(0));
    r.phase_light = r.light_weight = F(0);
    r.shadow_ray = MaskOf<F>(false);
    r.wo = {F(0), F(0), F(1)};
    r.pdf = F(1);
    return r;
}

// Lanes may be in different media.
template <int C, class F, class S>
TR_INLINE void scatter_in_medium(const SceneView<S> &scene, const IntOf<F> &medium, const Vec3<F> &p, const Vec3<F> &d,
                                 const Random4<F> &ue, const Random4<F> &ub, const MaskOf<F> &active,
                                 MediumScattering<F, C> &r) {
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &info = scene.media[m];
        r.albedo = select(lanes, eval_volume<C>(scene, scene.values, info.albedo, p, lanes), r.albedo);
        sample_light(scene, info, p, d, ue, lanes, r);
        Vec3<F> wo = sample_phase(scene, info.phase, p, d, ub.u[0], ub.u[1], ub.u[2], lanes);
        r.wo = select(lanes, wo, r.wo);
        r.pdf = select(lanes, eval_phase(scene, info.phase, p, d, wo, lanes), r.pdf);
    });
}

// Whether emitter samples are taken in these media, so that emission found by chance is weighted against them.
template <class F, class S>
TR_INLINE MaskOf<F> samples_lights(const SceneView<S> &scene, const IntOf<F> &medium, const MaskOf<F> &active) {
    MaskOf<F> r(false);
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        if (!scene.media[m].enclosed) r = r || lanes;
    });
    return r;
}

}  // namespace tr
