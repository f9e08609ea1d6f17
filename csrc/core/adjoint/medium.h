// The derivative of a segment through a medium. With the segment's transmittance T from its beginning, the light Ls
// scattered into the ray at u (the albedo's factor apart), and the light Lc arriving there from behind,
//     dL / d sigma(u) = T(u) (albedo(u) Ls(u) - Lc(u)),   dL / d albedo(u) = T(u) sigma(u) Ls(u),   dL / d eps(u) =
//     T(u).
// The extinction's is estimated at one point u a segment, its differential sample, uniform between its beginning and
// the collision (or its end), where both terms are taken: with l the length, E[l g(u)] is the integral of T g, and the
// path beyond u is a sample of Lc(u). No division by sigma: the estimate is unbiased where the density is zero. Ls(u)
// is an emitter sample at u, and for one segment a path, drawn with probability in proportion to what it may bring, a
// path that goes on from u (see Yu et al., "Sample Matching for Differentiable Volume Rendering", 2026; Nimier-David et
// al., "Unbiased Inverse Volume Rendering with Differential Trackers", SIGGRAPH 2022). The transmittance of a shadow
// ray has one uniform point a ray: d T = -T times the integral of d sigma.
#pragma once

#include "../integrator/medium.h"
#include "medium_motion.h"

namespace tr {

// What moves a segment's points: adjoints of the line from its beginning along its direction, `rest` of what is
// parametrised by that direction, `glued` of the light that arrives from a glued point behind.
template <class F>
struct SegmentMotion {
    MotionPacket<F> at;
    Vec3<F> d, collision_bar;  // the adjoint of a collision's place
    MaskOf<F> collided, ends_glued, seen_from_glued;
    LineAdjoint<F> rest, glued;
};

// `r`: radiance from the segment's end, `beta` the throughput there, `delta` the path's adjoint, `branch` the light of
// the path that goes on from the differential sample. Returns the radiance at the segment's beginning.
template <class F>
TR_LARGE Spectrum<F> sweep_segment(const SceneOf<F> &scene, const SegmentPacket<F> &v, const Spectrum<F> &delta,
                                   const Spectrum<F> &beta, const Spectrum<F> &r, const Spectrum<F> &branch,
                                   const MediumNeeds &needs, const MaskOf<F> &active, GradientSink<F> &sink,
                                   SegmentMotion<F> *motion = nullptr);

// Of a shadow ray: what its transmittance hands to its ends.
template <class F>
TR_LARGE LineAdjoint<F> sweep_shadow_motion(const SceneOf<F> &scene, const SegmentPacket<F> &v,
                                            const MotionPacket<F> &motion, const Vec3<F> &p, const Spectrum<F> &delta,
                                            const MaskOf<F> &active, GradientSink<F> &sink);

// What a collision brings of polarised light besides, the albedo and `a` apart: from behind, from the emitter sample,
// and that over what is emitted there. How it depends on directions has been handed on already.
template <class F>
struct PolarizedScattering {
    Spectrum<F> path, light, emitted;
};

// One collision; `a` is the adjoint times the throughput. `v.p` is the point, `v.d` the direction of travel. Returns
// N + albedo phase / (p q) R; adds the adjoints of the place and of the direction.
template <class F>
TR_LARGE Spectrum<F> sweep_collision(const SceneOf<F> &scene, const VertexRecord<F> &v, const IntOf<F> &medium,
                                     const Spectrum<F> &a, const NextVertex<F> &next, const GradientNeeds &needs,
                                     const MaskOf<F> &active, Vec3<F> &p_bar, Vec3<F> &d_bar, GradientSink<F> &sink,
                                     const PolarizedScattering<F> *polarized = nullptr);

}  // namespace tr
