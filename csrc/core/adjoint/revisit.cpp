#include "revisit.h"

#include "../bsdf/parameters.h"
#include "frame.h"
#include "stack.h"

namespace tr {

namespace {

template <class F>
TR_INLINE VertexRecord<F> read_surface(const TapeColumns<ScalarOf<F>> &tape, uint32_t i) {
    VertexRecord<F> v = read_vertex<F>(tape, i);
    read_scattering(tape, i, v);
    read_arrival(tape, i, v);
    return v;
}

}  // namespace

template <class F>
TR_LARGE Vec3<F> geometric_normal(const SceneOf<F> &scene, const TapeColumns<ScalarOf<F>> &tape, uint32_t i,
                                  const MaskOf<F> &active) {
    VertexRecord<F> v = read_vertex<F>(tape, i);
    read_arrival(tape, i, v);
    auto there = mask<UIntOf<F>>(active);
    SurfacePoint<F> at{select(there, v.at.shape, UIntOf<F>(0u)), select(there, v.at.primitive, UIntOf<F>(0u)), v.at.b1,
                       v.at.b2};
    return make_interaction(scene, Ray<F>{v.p - v.d * v.t, v.d}, at, v.t, active).ng;
}

template <class F>
TR_LARGE ScatteringLobe<F> scattering_lobe(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                                           const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const MaskOf<F> &active) {
    const BsdfKernels<F> &bsdf = bsdf_kernels<F>(kind);
    VertexRecord<F> v = read_surface<F>(tape, i);
    const Frame<F> frame = model_frame(scene, v);
    BsdfParameters<F> params;
    load_parameters(scene, waves, bsdf, v.bsdf, v.at, active, params);
    const Vec3<F> mirrored{-v.wi.x, -v.wi.y, v.wi.z};
    BsdfValue<F> peak, up;
    bsdf.eval_pdf(params, v.wi, mirrored, Transport::Radiance, peak);
    bsdf.eval_pdf(params, v.wi, {F(0), F(0), F(1)}, Transport::Radiance, up);
    // 1 / (1 + k (1 - cos) / 2)^2 has the density k / 4 pi where it is largest
    auto glossy = active && mask<F>(peak.pdf > F(0.5)) && mask<F>(peak.pdf < F(1e12));
    const F even = component_sum(magnitude(up.f)),
            more = max(F(0), component_sum(magnitude(peak.f)) - even * abs(mirrored.z));
    ScatteringLobe<F> r;
    r.k = select(glossy, peak.pdf * F(4 * Pi), F(0));
    r.share = select(glossy && mask<F>(more > F(0)), more / (more + even), F(0));
    r.axis = frame.to_world(mirrored);
    r.n = bsdf.is(Transmits) ? Vec3<F>{F(0), F(0), F(0)} : frame.n;
    return r;
}

template <class F>
TR_LARGE BsdfValue<F> scatter_towards(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                                      const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                                      const GradientNeeds &needs, const MaskOf<F> &active) {
    const BsdfKernels<F> &bsdf = bsdf_kernels<F>(kind);
    VertexRecord<F> v = read_surface<F>(tape, i);
    BsdfParameters<F> params;
    load_parameters(scene, waves, bsdf, v.bsdf, v.at, active, params);
    v.wo_light = v.wo = model_frame(scene, v).to_local(d);
    BsdfValue<F> value;
    bsdf.eval_pdf(params, v.wi, v.wo, Transport::Radiance, value);
    auto usable = active && mask<F>(value.pdf > F(0)) && is_finite(value.f);
    if (scene.has_stacks) {
        const StackAdjoint<F> stack(scene, waves, v, needs, Transport::Radiance, active);
        usable = usable && !stack.factor.hidden(stack.wi);
        const BsdfStack<F> &above = stack.bsdf.stack;
        value.f = value.f * (above.weight * above.inverse_probability * stack.light_factor);
    }
    return {select(usable, value.f, uniform_spectrum(F(0))), select(usable, value.pdf, F(0))};
}

namespace {

// A vertex whose path and whose light come from d, by smooth lobes. `chosen`: 1 over the probability with which its
// BSDF was found in its stack.
template <class F>
TR_INLINE VertexRecord<F> turned_vertex(const SceneOf<F> &scene, const Wavelengths<F> &waves,
                                        const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                                        const GradientNeeds &needs, const MaskOf<F> &active, F &chosen) {
    VertexRecord<F> v = read_surface<F>(tape, i);
    v.wo_light = v.wo = model_frame(scene, v).to_local(d);
    v.lobe = IntOf<F>(0);
    v.inverse_pdf = v.light_weight = F(0), chosen = F(1);
    if (scene.has_stacks)
        chosen = StackAdjoint<F>(scene, waves, v, needs, Transport::Radiance, active).bsdf.stack.inverse_probability;
    return v;
}

}  // namespace

template <class F>
TR_LARGE Stokes<F> row_towards(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                               const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                               const Stokes<F> &leaving, const GradientNeeds &needs, const MaskOf<F> &active) {
    F chosen;
    VertexRecord<F> v = turned_vertex(scene, waves, tape, i, d, needs, active, chosen);
    v.inverse_pdf = chosen;
    return PolarizedVertex<F>(scene, waves, kind, v, needs, active).row(leaving);
}

template <class F>
TR_LARGE Stokes<F> column_towards(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind,
                                  const TapeColumns<ScalarOf<F>> &tape, uint32_t i, const Vec3<F> &d,
                                  const EmitterPoint<F> &light, const Spectrum<F> &radiance, const GradientNeeds &needs,
                                  const MaskOf<F> &active) {
    F chosen;
    VertexRecord<F> v = turned_vertex(scene, waves, tape, i, d, needs, active, chosen);
    v.light = light, v.emitted = radiance, v.light_weight = chosen;
    return PolarizedVertex<F>(scene, waves, kind, v, needs, active).column(no_stokes<F>());
}

#define TR_INSTANTIATE(F, S)                                                                                         \
    template Vec3<F> geometric_normal(const SceneView<S> &, const TapeColumns<S> &, uint32_t, const MaskOf<F> &);    \
    template ScatteringLobe<F> scattering_lobe(const SceneView<S> &, const Wavelengths<F> &, int,                    \
                                               const TapeColumns<S> &, uint32_t, const MaskOf<F> &);                 \
    template BsdfValue<F> scatter_towards(const SceneView<S> &, const Wavelengths<F> &, int, const TapeColumns<S> &, \
                                          uint32_t, const Vec3<F> &, const GradientNeeds &, const MaskOf<F> &);      \
    template Stokes<F> row_towards(const SceneView<S> &, const Wavelengths<F> &, int, const TapeColumns<S> &,        \
                                   uint32_t, const Vec3<F> &, const Stokes<F> &, const GradientNeeds &,              \
                                   const MaskOf<F> &);                                                               \
    template Stokes<F> column_towards(const SceneView<S> &, const Wavelengths<F> &, int, const TapeColumns<S> &,     \
                                      uint32_t, const Vec3<F> &, const EmitterPoint<F> &, const Spectrum<F> &,       \
                                      const GradientNeeds &, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
