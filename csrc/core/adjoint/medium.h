// The derivative of a segment through a medium. With the segment's transmittance T from its beginning, the light Ls
// scattered into the ray at u (the albedo's factor apart), and the light Lc arriving there from behind,
//     dL / d sigma(u) = T(u) (albedo(u) Ls(u) - Lc(u)),   dL / d albedo(u) = T(u) sigma(u) Ls(u),   dL / d eps(u) =
//     T(u).
// The extinction's is estimated at one point u a segment, uniform between its beginning and the collision (or its end),
// where both terms are taken: with l the length, E[l g(u)] is the integral of T g, and the path beyond u is a sample of
// Lc(u). No division by sigma: the estimate is unbiased where the density is zero. Ls(u) is an emitter sample at u, and
// for one segment a path, drawn with probability in proportion to what it may bring, a path that goes on from u (see
// Yu et al., "Sample Matching for Differentiable Volume Rendering", 2026; Nimier-David et al., "Unbiased Inverse Volume
// Rendering with Differential Trackers", SIGGRAPH 2022).
// The transmittance of a shadow ray has one uniform point a ray: d T = -T times the integral of d sigma.
#pragma once

#include "../integrator/medium.h"
#include "sweep.h"

namespace tr {

template <class F, int C, class S, class Sink>
TR_INLINE void sweep_extinction(const SceneView<S> &scene, const MediumInfo &medium, const Vec3<F> &p,
                                const Color<F, C> &g, MaskOf<F> active, Sink &sink) {
    if (medium.flags & IsGrid) active = active && inside_grid(scene, medium, p);
    if (!any(active)) return;
    sweep_volume(scene, medium.extinction, p, g * F(scene.values.constants[medium.scale]), active, sink);
    sink.number(scene, IntOf<F>(medium.scale), g * eval_volume<C>(scene, scene.values, medium.extinction, p, active),
                active);
}

// What the path tape keeps of a segment, besides its end. Values are radiance that reaches the camera.
template <class F, int C>
struct FlightRecord {
    IntOf<F> medium;  // -1: in none
    F length;
    Vec3<F> probe;
    Color<F, C> probe_value;  // light scattered at the probe, by emitter sampling
    // shadow ray of the segment's end: a point on its way, what arrives through it, its length and medium there
    Vec3<F> shadow;
    Color<F, C> shadow_value;
    F shadow_length;
    IntOf<F> shadow_medium;
    // emission: a point, and whether it is behind the probe
    Vec3<F> glow;
    MaskOf<F> glow_behind;
    // throughput at the beginning; what coloured extinction multiplies it with up to the end, and up to `glow`
    Color<F, C> first, weight, glow_weight;
};

// `r`: radiance from the segment's end, `end` its throughput there, `delta` the path's adjoint, `branch` the light of
// the path that goes on from the probe. Returns the radiance at the segment's beginning.
template <int C, class F, class S, class Sink>
TR_INLINE Color<F, C> sweep_flight(const SceneView<S> &scene, const FlightRecord<F, C> &v, const Color<F, C> &delta,
                                   const Color<F, C> &end, const Color<F, C> &r, const Color<F, C> &branch,
                                   const MediumWanted &wanted, const MaskOf<F> &active, Sink &sink) {
    Color<F, C> total = r * v.weight;
    for_each_distinct<F>(v.medium, active && mask<F>(v.medium >= 0), [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &medium = scene.media[m];
        Color<F, C> behind = end * r;
        if (medium.emission >= 0) {
            Color<F, C> glow = v.glow_weight * v.length;
            Color<F, C> emitted = glow * eval_volume<C>(scene, scene.values, medium.emission, v.glow, lanes);
            total = select(lanes, total + emitted, total);
            behind = behind + select(v.glow_behind, v.first * emitted, uniform_color<C>(F(0)));
            if (wanted.emission) sweep_volume(scene, medium.emission, v.glow, delta * v.first * glow, lanes, sink);
        }
        if (wanted.extinction)
            sweep_extinction(scene, medium, v.probe, delta * (v.probe_value + branch - behind) * v.length, lanes, sink);
    });
    if (!wanted.extinction) return total;
    auto shadowed = active && mask<F>(v.shadow_medium >= 0) && mask<F>(v.shadow_length > F(0));
    for_each_distinct<F>(v.shadow_medium, shadowed, [&](int32_t m, const MaskOf<F> &lanes) {
        sweep_extinction(scene, scene.media[m], v.shadow, delta * v.shadow_value * (-v.shadow_length), lanes, sink);
    });
    return total;
}

// One collision; `a` is the adjoint times the throughput. `v.p` is the point, `v.d` the direction of travel. Returns
// N + albedo phase / (p q) R.
template <int C, class F, class S, class Sink>
TR_INLINE Color<F, C> sweep_collision(const SceneView<S> &scene, const VertexRecord<F, C> &v, const IntOf<F> &medium,
                                      const Color<F, C> &a, const Color<F, C> &next, const Wanted &wanted,
                                      const MaskOf<F> &active, Sink &sink) {
    Color<F, C> total = uniform_color<C>(F(0));
    for_each_distinct<F>(medium, active, [&](int32_t m, const MaskOf<F> &lanes) {
        const MediumInfo &info = scene.media[m];
        Color<F, C> albedo = eval_volume<C>(scene, scene.values, info.albedo, v.p, lanes);
        F phase = eval_phase(scene, info.phase, v.p, v.d, v.wo, lanes);
        F phase_light = eval_phase(scene, info.phase, v.p, v.d, v.wo_light, lanes);
        Color<F, C> light_factor = v.emitted * v.through * v.light_weight, path_factor = next * v.inverse_pdf;
        Color<F, C> scattered = light_factor * phase_light + path_factor * phase;
        total = select(lanes, albedo * scattered, total);
        if (wanted.medium.albedo) sweep_volume(scene, info.albedo, v.p, a * scattered, lanes, sink);
        if (wanted.medium.phase) {
            sweep_phase(scene, info.phase, v.p, v.d, v.wo, a * albedo * path_factor, lanes, sink);
            sweep_phase(scene, info.phase, v.p, v.d, v.wo_light, a * albedo * light_factor, lanes, sink);
        }
        auto lit = lanes && mask<F>(v.light_weight > F(0));
        if (wanted.emitter && any(lit)) {
            CoordinateAdjoint<F> at;
            Vec3<F> d_bar{F(0), F(0), F(0)};
            sweep_emitter(scene, v.light, v.wo_light, a * albedo * v.through * (phase_light * v.light_weight), wanted,
                          lit, at, d_bar, sink);
        }
    });
    return total;
}

}  // namespace tr
