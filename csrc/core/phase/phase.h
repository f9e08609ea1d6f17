// What integrators know of a phase function: a table of functions on packets. Each model is one translation unit that
// fills in such a table; the registry below lists them. The index of a phase function is the same in all lanes: callers
// go through media one by one. Phase functions are their own densities: a sample's value over its density is 1.
#pragma once

#include "../typelist.h"
#include "../volume/volume.h"

// One line a model, each a file here; the position is the model's kind.
#define TR_PHASES(X)    \
    X(Isotropic)        \
    X(HenyeyGreenstein) \
    X(Rayleigh)         \
    X(TabulatedPhase)   \
    X(BlendPhase)

namespace tr {

template <class F>
class GradientSink;

template <class F>
struct PhaseKernels : ModelInfo {
    using Scene = SceneOf<F>;
    using M = MaskOf<F>;

    // The value (and density per solid angle) of scattering at p from the direction of travel `d` into `wo`.
    F (*eval)(const Scene &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo, const M &);
    // A direction, distributed as `eval` says. u0 chooses between the parts of a blend.
    Vec3<F> (*sample)(const Scene &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const F &u0, const F &u1,
                      const F &u2, const M &);
    // The derivative of `eval` with respect to the cosine of the angle between d and wo, which all depend on; adds what
    // it has with respect to p to `p_bar`, g being the adjoint of its value.
    F (*slope)(const Scene &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo, const F &g,
               const M &, Vec3<F> &p_bar, GradientSink<F> &);
    // The derivative of `eval` with respect to the parameters; g is the adjoint of its value, component by component.
    // Null without parameters.
    void (*vjp)(const Scene &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                const Spectrum<F> &g, const M &, GradientSink<F> &);
};

#define TR_NAME(M) struct M;
TR_PHASES(TR_NAME)
#undef TR_NAME
struct NoPhase;
#define TR_NAME(M) M,
using Phases = TypeList<TR_PHASES(TR_NAME) NoPhase>;  // the last stands for none
#undef TR_NAME
constexpr int PhaseKinds = Phases::Size - 1;

template <class M, class F>
TR_DEVICE_CONSTEXPR PhaseKernels<F> phase_kernels_of();

template <class F>
TR_HD const PhaseKernels<F> &phase_kernels(int kind);

// Calls visit(table) for the model of a kind, and returns what that returns. `blends`: it may be a blend.
template <class F, bool blends = true, class Visit>
TR_INLINE auto visit_phase_kind(int32_t kind, Visit &&visit) {
#if defined(TR_ONE_SCENE)  // calls of known functions, which are compiled for all lanes together
#define TR_CASE(M)                                                                                 \
    if constexpr (facts::has(facts::PhaseKinds, kind_of_model<M>(Phases{})) &&                     \
                  (blends || kind_of_model<M>(Phases{}) != kind_of_model<BlendPhase>(Phases{}))) { \
        constexpr PhaseKernels<F> of_##M = phase_kernels_of<M, F>();                               \
        if (kind == kind_of_model<M>(Phases{})) return visit(of_##M);                              \
    }
    TR_PHASES(TR_CASE)
#undef TR_CASE
    return decltype(visit(phase_kernels<F>(kind)))();
#else
    return visit(phase_kernels<F>(kind));
#endif
}

template <class F>
TR_INLINE F eval_phase(const SceneOf<F> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                       const MaskOf<F> &active) {
    const Record &record = scene.phases[phase];
    return visit_phase_kind<F>(
        record.kind, [&](const PhaseKernels<F> &model) { return model.eval(scene, record, p, d, wo, active); });
}
template <class F>
TR_INLINE Vec3<F> sample_phase(const SceneOf<F> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d, const F &u0,
                               const F &u1, const F &u2, const MaskOf<F> &active) {
    const Record &record = scene.phases[phase];
    return visit_phase_kind<F>(record.kind, [&](const PhaseKernels<F> &model) {
        return model.sample(scene, record, p, d, u0, u1, u2, active);
    });
}
template <class F>
TR_INLINE F phase_slope(const SceneOf<F> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                        const F &g, const MaskOf<F> &active, Vec3<F> &p_bar, GradientSink<F> &sink) {
    const Record &record = scene.phases[phase];
    return visit_phase_kind<F>(record.kind, [&](const PhaseKernels<F> &model) {
        return model.slope(scene, record, p, d, wo, g, active, p_bar, sink);
    });
}
template <class F>
TR_INLINE void sweep_phase(const SceneOf<F> &scene, int32_t phase, const Vec3<F> &p, const Vec3<F> &d,
                           const Vec3<F> &wo, const Spectrum<F> &g, const MaskOf<F> &active, GradientSink<F> &sink) {
    const Record &record = scene.phases[phase];
    visit_phase_kind<F>(record.kind, [&](const PhaseKernels<F> &model) {
        if (model.vjp) model.vjp(scene, record, p, d, wo, g, active, sink);
    });
}

}  // namespace tr
