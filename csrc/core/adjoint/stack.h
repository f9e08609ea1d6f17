// The derivative of the BSDFs above a resolved one: of the weights of branches, of the factor near the terminator, and
// of a perturbed normal. With branch weights w_j and what the resolved BSDF brings, X, the vertex brings w_1 w_2 ... X.
#pragma once

#include "../integrator/bsdf_stack.h"
#include "vertex.h"

namespace tr {

// A vertex with its stack found again.
template <class F>
struct StackAdjoint {
    ResolvedBsdf<F> bsdf;
    PerturbationFactor<F> factor;
    Vec3<F> wi, wo, wo_light;                             // in the world
    F light_factor{1}, path_factor{1};                    // of `factor`
    Vec3<F> base_bar{F(0), F(0), F(0)}, n_bar{base_bar};  // what the shadowing function adds

    StackAdjoint() = default;  // of a scene without stacks
    TR_LARGE StackAdjoint(const SceneOf<F> &scene, const Wavelengths<F> &waves, const VertexRecord<F> &v,
                          const GradientNeeds &needs, Transport transport, const MaskOf<F> &active);

    // Adds, for contributions of these sizes, the derivative of their factor: to the adjoint of the direction that
    // light comes from, and to those of the normals.
    TR_LARGE void sweep_shadowing(const Vec3<F> &normal, Transport transport, const F &by_light, const F &by_path,
                                  Vec3<F> &light_bar, Vec3<F> &path_bar, Vec3<F> &wi_bar);

    // `whole`: what the resolved BSDF brings, times the adjoint of the vertex above the stack.
    TR_LARGE void finish(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &whole,
                         const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                         GradientSink<F> &sink);

private:
    TR_LARGE void sweep_weights(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &g,
                                const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                GradientSink<F> &sink);
    TR_LARGE void sweep_perturbed_normal(const SceneOf<F> &scene, const VertexRecord<F> &v, const GradientNeeds &needs,
                                         HitAdjoint<F> &hit, GradientSink<F> &sink);
};

}  // namespace tr
