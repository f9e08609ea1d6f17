// The path tracer, a vertex at a time: what happens where a ray has hit something. Scheduling (tiles, queries, threads
// or kernels) is elsewhere and calls these functions.
//
// Unidirectional with emitter sampling and BSDF sampling combined by the power heuristic (Veach 1997, section 9.2),
// delta lobes, Russian roulette on throughput * eta^2. Notation of the derivative (adjoint/sweep.h): at vertex k
//   E_k  emission found by BSDF sampling,   N_k  emission found by emitter sampling,
//   f_k / (p_k q_k)  the weight with which the path goes on;   L = beta_0 (E_0 + N_0 + f_0 / (p_0 q_0) (E_1 + ...)).
#pragma once

#include "../bsdf/bsdf.h"
#include "../emitter/emitter.h"
#include "../sampler/sobol.h"
#include "../sampler/stratified.h"
#include "layers.h"

namespace tr {

struct PathConfig {
    int32_t max_depth;        // vertices whose emission counts; -1: unlimited
    int32_t rr_depth;         // Russian roulette after this many scatterings
    bool hide_emitters;       // the camera does not see lights
    int32_t emitter_samples;  // at the first vertex: 1 and 1 for the path tracer,
    int32_t bsdf_samples;     // others for direct illumination, which stops at the second vertex
    uint64_t seed;
    uint32_t sensor;
    SamplerConfig sampler;
    bool volumetric;  // through media; see medium.h here
};

// Random numbers of a path: block 0 is the camera's; scattering j takes block 1 + 2 j (emitter: 3 numbers, roulette: 1)
// and 2 + 2 j (BSDF: 3 numbers, layers: 1).
constexpr uint32_t EmitterBlock = 1, BsdfBlock = 2, BlocksPerScattering = 2;

// The numbers of a block of a sample. Two of them are a point in the plane: the first two of the camera's (on the
// film), the second and third of the others (on a light, or of a direction), whose first one chooses (a light, a lobe)
// and is there if three are `wanted`; the last one if four are.
template <class F>
TR_INLINE Random4<F> draw4(const PathConfig &config, const UIntOf<F> &pixel, const UIntOf<F> &sample, uint32_t block,
                           int wanted) {
    if (config.sampler.kind == SamplerKind::Independent)
        return random4<F>(config.seed, config.sensor, pixel, sample, block);
    Random4<F> r = config.sampler.kind == SamplerKind::Sobol
                       ? sobol4<F>(config.sampler, config.seed, config.sensor, pixel, sample, block, wanted)
                       : stratified4<F>(config.sampler, config.seed, config.sensor, pixel, sample, block, wanted);
    return block == 0 ? r : Random4<F>{{r.u[2], r.u[0], r.u[1], r.u[3]}};
}

template <class F>
TR_INLINE F power_heuristic(const F &a, const F &b) {
    F a2 = a * a, b2 = b * b;
    auto usable = mask<F>(a2 > F(0));
    return select(usable, a2 / select(usable, a2 + b2, F(1)), F(0));
}

// Where a ray came from: what the weight of emission found at its end needs.
template <class F>
struct Origin {
    Vec3<F> p;
    F pdf;  // of the BSDF sample; 0 after a delta lobe and for camera rays, whose emission has weight 1
};

// Emission of the surface that was hit, weighted against emitter sampling.
template <class F, int C>
struct Emission {
    EmitterPoint<F> point;
    F weight;  // 0 where there is none
    Color<F, C> radiance;
};

template <int C, class F, class S>
TR_INLINE Emission<F, C> surface_emission(const SceneView<S> &scene, const PathConfig &config, const Interaction<F> &si,
                                          const F &cos_i, const Origin<F> &from, const MaskOf<F> &active,
                                          bool first_bounce) {
    Emission<F, C> r;
    r.point.at = si.at;
    r.point.emitter = si.shape.emitter;
    auto lit = active && mask<F>(r.point.emitter >= 0) && mask<F>(cos_i > F(0));
    r.weight = F(0);
    r.radiance = uniform_color<C>(F(0));
    if (any(lit)) {
        F pdf = area_light_pdf(scene, r.point.emitter, si.at.shape, from.p, si.p, si.ng, lit);
        if (first_bounce) pdf = pdf * (F(config.emitter_samples) / F(config.bsdf_samples));
        F weight = select(mask<F>(from.pdf > F(0)), power_heuristic(from.pdf, pdf), F(1));
        r.weight = select(lit, weight, F(0));
        r.radiance = select(lit, eval_emitter<C>(scene, r.point, lit) * weight, r.radiance);
    }
    return r;
}

// The same for a ray that left the scene.
template <int C, class F, class S>
TR_INLINE Emission<F, C> environment_emission(const SceneView<S> &scene, const PathConfig &config, const Vec3<F> &d,
                                              const Origin<F> &from, const MaskOf<F> &active, bool first_bounce) {
    Emission<F, C> r;
    r.point = environment_point(scene, d);
    F pdf = environment_pdf(scene, r.point, active);
    if (first_bounce) pdf = pdf * (F(config.emitter_samples) / F(config.bsdf_samples));
    F weight = select(mask<F>(from.pdf > F(0)), power_heuristic(from.pdf, pdf), F(1));
    r.weight = select(active, weight, F(0));
    r.radiance = eval_emitter<C>(scene, r.point, active) * r.weight;
    return r;
}

// One scattering: an emitter sample and a BSDF sample at a vertex.
template <class F, int C>
struct Scattering {
    // emitter sampling; N = f_light * emitted * light_weight where the shadow ray is free
    EmitterSample<F> light;
    Vec3<F> wo_light;  // local
    Color<F, C> emitted, f_light;
    F light_weight;  // m / p * factor
    MaskOf<F> shadow_ray;
    // BSDF sampling
    BsdfSample<F> sample;
    Color<F, C> f;
    F inverse_pdf;  // 1 / p (before Russian roulette)
    MaskOf<F> alive;
};

// What the layers above a leaf make of what it scatters.
template <int C, class F, class S>
TR_NOINLINE void scatter_through_layers(const SceneView<S> &scene, const Interaction<F> &si, const Vec3<F> &wi,
                                        const Leaf<F> &leaf, const MaskOf<F> &active, Scattering<F, C> &r) {
    const Layers<F> &layers = leaf.layers;
    r.f = r.f * layers.weight;
    r.f_light = r.f_light * layers.weight;
    r.inverse_pdf = r.inverse_pdf * layers.inverse_probability;
    r.light_weight = r.light_weight * layers.inverse_probability;
    TurnedFactor<F> factor(scene, leaf, si.frame.n, active);
    if (!any(factor.turned)) return;
    Vec3<F> local = r.sample.wo, from = wi;
    local.z = select(leaf.mirrored, -local.z, local.z);
    from.z = select(leaf.mirrored, -from.z, from.z);
    Vec3<F> wo = si.frame.to_world(local);
    auto seen = !factor.hidden(si.frame.to_world(from));
    r.shadow_ray = r.shadow_ray && seen && !factor.hidden(r.light.d);
    r.alive = r.alive && seen && !factor.hidden(wo);
    r.f_light = r.f_light * factor(r.light.d, r.light.d);
    r.f = r.f * factor(wo, wo);
    r.light_weight = select(r.shadow_ray, r.light_weight, F(0));
    r.inverse_pdf = select(r.alive, r.inverse_pdf, F(0));
}

template <class Model, int C, class F, class S>
TR_INLINE void scatter_here(const SceneView<S> &scene, const PathConfig &config, const Interaction<F> &si,
                            const Vec3<F> &wi, const Leaf<F> &leaf, int index, int depth, const Random4<F> &ue,
                            const Random4<F> &ub, const MaskOf<F> &active, Scattering<F, C> &r) {
    auto params = load_params<Model, C>(scene, leaf.bsdf, si.at, active);
    F mirror = select(leaf.mirrored, F(-1), F(1));
    bool splits = depth == 0;
    F n_emitter(S(splits ? config.emitter_samples : 1)), n_bsdf(S(splits ? config.bsdf_samples : 1));

    r.shadow_ray = MaskOf<F>(false);
    r.light_weight = F(0);
    r.wo_light = {F(0), F(0), F(1)};
    r.emitted = r.f_light = uniform_color<C>(F(0));
    r.light = no_emitter_sample<F>();
    if constexpr (Model::Smooth) {
        if (scene.n_emitters > 0 && index < config.emitter_samples) {
            r.light = sample_emitter(scene, si.p, ue.u[0], ue.u[1], ue.u[2], active);
            r.wo_light = si.frame.to_local(r.light.d);
            r.wo_light.z = r.wo_light.z * mirror;
            r.f_light = eval_bsdf<Transport::Radiance, Model, C>(params, wi, r.wo_light, IntOf<F>(0));
            F pdf_bsdf = Model::template pdf<C>(params, wi, r.wo_light);
            // a black reflectance still has a derivative: what matters is that the direction is possible
            auto possible = active && mask<F>(r.light.pdf > F(0)) && mask<F>(pdf_bsdf > F(0));
            if (any(possible)) {
                F weight = select(r.light.delta, F(1), power_heuristic(n_emitter * r.light.pdf, n_bsdf * pdf_bsdf));
                r.light_weight =
                    select(possible, weight * r.light.factor / select(possible, n_emitter * r.light.pdf, F(1)), F(0));
                r.emitted = eval_emitter<C>(scene, r.light.point, possible);
            }
            r.shadow_ray = possible;
        }
    }

    r.sample = Model::template sample<C>(params, wi, ub.u[0], ub.u[1], ub.u[2]);
    r.f = eval_bsdf<Transport::Radiance, Model, C>(params, wi, r.sample.wo, r.sample.lobe);
    auto possible = active && mask<F>(r.sample.pdf > F(0)) && mask<F>(F(index) < n_bsdf);
    r.inverse_pdf = select(possible, F(1) / select(possible, n_bsdf * r.sample.pdf, F(1)), F(0));
    r.alive = possible;
    if (scene.layered) scatter_through_layers(scene, si, wi, leaf, active, r);
}

template <class Model, int C, class F, class S>
TR_NOINLINE void scatter_large(const SceneView<S> &scene, const PathConfig &config, const Interaction<F> &si,
                               const Vec3<F> &wi, const Leaf<F> &leaf, int index, int depth, const Random4<F> &ue,
                               const Random4<F> &ub, const MaskOf<F> &active, Scattering<F, C> &r) {
    scatter_here<Model>(scene, config, si, wi, leaf, index, depth, ue, ub, active, r);
}
template <class Model, int C, class F, class S>
TR_INLINE void scatter(const SceneView<S> &scene, const PathConfig &config, const Interaction<F> &si, const Vec3<F> &wi,
                       const Leaf<F> &leaf, int index, int depth, const Random4<F> &ue, const Random4<F> &ub,
                       const MaskOf<F> &active, Scattering<F, C> &r) {
    if constexpr (IsLarge<Model>)
        scatter_large<Model>(scene, config, si, wi, leaf, index, depth, ue, ub, active, r);
    else
        scatter_here<Model>(scene, config, si, wi, leaf, index, depth, ue, ub, active, r);
}

}  // namespace tr
