// The derivative of a path, one vertex at a time, from its end to its beginning.
//
// With the suffix radiance  R_k = E_k + N_k + f_k / (p_k q_k) R_{k+1}  and the pixel's adjoint delta, A_k = delta
// beta_k:
//     dL = sum_k  A_k ( dE_k + dN_k + df_k / (p_k q_k) R_{k+1} ).
// Sampling densities, MIS weights, roulette and visibility are constants of the derivative (detached sampling: Zeltner,
// Speierer, Georgiev and Jakob, "Monte Carlo Estimators for Differential Light Transport", SIGGRAPH 2021). Nothing is
// traced again and nothing is divided by f: where f = 0 its derivative is as good as anywhere.
//
// What moves (surface.h): the point that a smooth BSDF's ray has hit, or that was sampled on a light, is glued to its
// surface. With D = x_{k+1} - x_k the integrand is a function of both ends, through the direction w = D / |D| and, area
// being the measure, through J = |N_{k+1}.D| / |D|^3 relative to its current value (the material form of Zhang, Miller,
// Yan, Gkioulekas and Zhao, "Path-Space Differentiable Rendering", SIGGRAPH 2020). Camera rays and those that leave a
// delta lobe are functions of the camera, of the interface and of its index: what they hit slides, and the derivative
// of the ray is handed on from vertex to vertex (RayAdjoint) until a smooth BSDF ends the chain.
#pragma once

#include "../bsdf/parameters.h"
#include "frame.h"
#include "stack.h"

namespace tr {

// What an emitter sends from the points of `lanes`, see EmitterKernels::vjp.
template <class F>
TR_LARGE void sweep_emitter(const SceneOf<F> &scene, const EmitterPoint<F> &point, const Vec3<F> &d,
                            const Spectrum<F> &g, const GradientNeeds &needs, const MaskOf<F> &active,
                            CoordinateAdjoint<F> &at, Vec3<F> &d_bar, GradientSink<F> &sink);

// The way from sampled points to the reference points of `lit`, see DirectAdjoint; returns the adjoint of the latter.
template <class F>
TR_LARGE Vec3<F> sweep_direct(const SceneOf<F> &scene, const DirectAdjoint<F> &g, const MaskOf<F> &lit,
                              GradientSink<F> &sink);

// One scattering vertex of this kind; `a` is A_k. Returns N_k + f_k / (p_k q_k) R_{k+1}; adds the adjoints of the hit
// and of the arriving ray's direction. `next` is spent.
template <class F>
TR_LARGE Spectrum<F> sweep_scattering(const SceneOf<F> &scene, int kind, const VertexRecord<F> &v, Spectrum<F> a,
                                      NextVertex<F> &next, const GradientNeeds &needs, const MaskOf<F> &active,
                                      HitAdjoint<F> &hit, Vec3<F> &d_bar, GradientSink<F> &sink);

// The BSDF of a vertex, towards the next vertex and towards what was connected: a light, or the camera of a light path.
// f_path and f_light with their derivatives, for the number a (f_path path_factor + f_light light_factor).
template <class F>
struct BsdfAdjoint {
    const BsdfKernels<F> &bsdf;
    BsdfParameters<F> params;
    BsdfDerivative<F> path, light;
    bool connected;  // `light` is there

    // `lit`: lanes with a connection
    TR_LARGE BsdfAdjoint(const SceneOf<F> &scene, int kind, const VertexRecord<F> &v, Transport transport,
                         const Spectrum<F> &a, const Spectrum<F> &path_factor, const Spectrum<F> &light_factor,
                         const GradientNeeds &needs, const MaskOf<F> &lit, const MaskOf<F> &active, HitAdjoint<F> &hit,
                         GradientSink<F> &sink);

    // What moves on along the path. Adds to `hit` and to the adjoint of the local wi.
    TR_LARGE void sweep_continuation(const SceneOf<F> &scene, const VertexRecord<F> &v, const NextVertex<F> &next,
                                     const MaskOf<F> &active, VertexFrame<F> &frame, Vec3<F> &wi_bar,
                                     HitAdjoint<F> &hit, GradientSink<F> &sink) const;
};

}  // namespace tr
